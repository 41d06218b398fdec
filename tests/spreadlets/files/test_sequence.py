import pytest

from spreadlets.errors import InvalidFileError, InvalidParameterError
from spreadlets.files.sequence import (
    existing_frames,
    is_pattern,
    listed,
    numbered,
    parse_frames,
    sequence_frames,
)


def touch(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("")


@pytest.mark.parametrize(
    ("pattern", "number", "path"),
    [
        ("frame.####.exr", 7, "frame.0007.exr"),
        ("frame.####.exr", 12345, "frame.12345.exr"),
        ("frame_#.exr", 12, "frame_12.exr"),
        ("frame.%04d.exr", 7, "frame.0007.exr"),
        ("frame.%d.exr", 7, "frame.7.exr"),
        ("shot_%03d/beauty.exr", 7, "shot_007/beauty.exr"),
        ("camera.json", 7, "camera.json"),
        ("100%.exr", 7, "100%.exr"),
        ("####.exr", 7, "0007.exr"),
        ("####_beauty_v2.exr", 7, "0007_beauty_v2.exr"),
        ("shot#2_v1.####.exr", 7, "shot#2_v1.0007.exr"),
        ("shot_##/frame.####.exr", 7, "shot_07/frame.0007.exr"),
        ("frame.@@@.exr", 7, "frame.007.exr"),
        ("frame.$F4.exr", 7, "frame.0007.exr"),
        ("frame.$F.exr", 7, "frame.7.exr"),
        ("frame.####.exr", -7, "frame.-007.exr"),
    ],
)
def test_counters_become_numbers(pattern, number, path):
    assert numbered(pattern, number) == path
    assert is_pattern(pattern) == (pattern != path)


def test_a_file_that_has_the_name_of_a_pattern_is_itself(tmp_path):
    touch(tmp_path, "take#2.exr")
    assert not is_pattern(str(tmp_path / "take#2.exr")) and is_pattern(str(tmp_path / "take#3.exr"))


def test_a_folder_of_a_patterns_name_is_itself(tmp_path):
    pattern = str(tmp_path / "take#2" / "out.exr")
    assert numbered(pattern, 7) == str(tmp_path / "take72" / "out.exr")
    (tmp_path / "take#2").mkdir()
    assert not is_pattern(pattern)
    assert numbered(str(tmp_path / "take#2" / "out.##.exr"), 7) == str(tmp_path / "take#2" / "out.07.exr")


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("3", [3]),
        ("1-4", [1, 2, 3, 4]),
        ("1-8x3", [1, 4, 7]),
        ("9, 1-3,2", [1, 2, 3, 9]),
        ("0-0", [0]),
        ("4-1", [1, 2, 3, 4]),
        ("-2-0", [-2, -1, 0]),
    ],
)
def test_ranges_of_frames(text, numbers):
    assert parse_frames(text) == numbers


@pytest.mark.parametrize("text", ["", "a", "1-", "1-4x0", "1.5-3", "1-99999999", "1-2000000"])
def test_what_is_no_range_is_refused(text):
    with pytest.raises(InvalidParameterError, match="frames"):
        parse_frames(text)


def test_existing_frames_are_found_by_their_digits(tmp_path):
    touch(tmp_path, "f.0001.exr", "f.0010.exr", "f.12345.exr", "f.010.exr", "f.00012.exr", "f.abcd.exr", "g.0002.exr")
    assert existing_frames(str(tmp_path / "f.####.exr")) == [1, 10, 12345]
    assert existing_frames(str(tmp_path / "f.%03d.exr")) == [10, 12345]
    touch(tmp_path, "h.-001.exr", "h.0000.exr", "h.-0001.exr")
    assert existing_frames(str(tmp_path / "h.####.exr")) == [-1, 0]
    touch(tmp_path, "[a]1/f.exr", "[a]2/f.exr")
    assert existing_frames(str(tmp_path / "[a]#" / "f.exr")) == [1, 2]
    touch(tmp_path, "shot1/1.exr", "shot2/3.exr")
    assert existing_frames(str(tmp_path / "shot#" / "#.exr")) == [1]


def test_the_frames_of_a_sequence(tmp_path):
    front, back, out = (str(tmp_path / name) for name in ("front.##.exr", "back.exr", "out.##.exr"))
    touch(tmp_path, "front.01.exr", "front.02.exr", "front.05.exr", "back.exr", "camera.02.json")
    assert sequence_frames([front, back], [], out, None) == ([1, 2, 5], [3, 4])
    assert sequence_frames([front, back], [], out, "1-2") == ([1, 2], [])
    camera = str(tmp_path / "camera.##.json")
    assert sequence_frames([front, back], [], out, "1-3") == ([1, 2, 3], [])
    with pytest.raises(InvalidFileError, match=r"front\.##\.exr: 2 frames are missing: 3-4"):
        sequence_frames([front, back], [], out, "3-4")
    with pytest.raises(InvalidFileError, match=r"camera\.##\.json: 2 frames are missing: 1, 5"):
        sequence_frames([front, back], [camera], out, "1,5")
    with pytest.raises(InvalidFileError, match="no such frames exist"):
        sequence_frames([str(tmp_path / "none.##.exr")], [], out, None)
    with pytest.raises(InvalidParameterError, match=r"the output .*back\.png needs a counter"):
        sequence_frames([front], [], str(tmp_path / "back.png"), None)
    with pytest.raises(InvalidParameterError, match="would replace the frames"):
        sequence_frames([front], [], str(tmp_path / "front.%02d.exr"), None)


def test_long_lists_of_frames_are_cut():
    assert listed([1, 2, 3, 7, 9, 10]) == "1-3, 7, 9-10"
    assert listed(range(0, 100, 2)).endswith("36, 38, ...")
