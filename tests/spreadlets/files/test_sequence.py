import pytest

from spreadlets.errors import InvalidFileError, InvalidParameterError
from spreadlets.files.sequence import (
    existing_frames,
    is_pattern,
    listed,
    numbered,
    parse_frames,
    run_sequence,
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
        ("frame_####_beauty.exr", 7, "frame_0007_beauty.exr"),
        ("frame.$F4.exr", 7, "frame.0007.exr"),
        ("frame.$F.exr", 7, "frame.7.exr"),
        ("frame.@@@@.exr", 7, "frame.0007.exr"),
        ("frame.####.exr", -7, "frame.-007.exr"),
        ("camera.json", 7, "camera.json"),
        ("100%.exr", 7, "100%.exr"),
    ],
)
def test_counters_become_numbers(pattern, number, path):
    assert numbered(pattern, number) == path
    assert is_pattern(pattern) == (pattern != path)


def test_a_file_that_has_the_name_of_a_pattern_is_itself(tmp_path):
    touch(tmp_path, "take#2.exr")
    assert not is_pattern(str(tmp_path / "take#2.exr")) and is_pattern(str(tmp_path / "take#3.exr"))


def test_every_counter_is_the_frame_number(tmp_path):
    assert numbered("take##/frame.####.exr", 1) == "take01/frame.0001.exr"
    touch(tmp_path, "take01/f.0001.exr", "take02/f.0002.exr", "take03/f.0004.exr")
    assert existing_frames(str(tmp_path / "take##" / "f.####.exr")) == [1, 2]


def test_a_counter_in_the_name_of_a_folder_that_exists_is_none(tmp_path):
    touch(tmp_path, "shot#3/take.0007.exr", "shot3/take.0008.exr")
    pattern = str(tmp_path / "shot#3" / "take.####.exr")
    assert numbered(pattern, 7).endswith("shot#3/take.0007.exr") and existing_frames(pattern) == [7]
    assert not is_pattern(str(tmp_path / "shot#3" / "out.exr"))


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("3", [3]),
        ("1-4", [1, 2, 3, 4]),
        ("1-8x3", [1, 4, 7]),
        ("9, 1-3,2", [1, 2, 3, 9]),
        ("0-0", [0]),
        ("-3", [-3]),
        ("-2-1", [-2, -1, 0, 1]),
    ],
)
def test_ranges_of_frames(text, numbers):
    assert parse_frames(text) == numbers


@pytest.mark.parametrize("text", ["", "a", "1-", "4-1", "1-4x0", "--3", "1--3", "1-99999999", "1,,2"])
def test_what_is_no_range_is_refused(text):
    with pytest.raises(InvalidParameterError, match="frames"):
        parse_frames(text)


def test_existing_frames_are_found_by_their_digits(tmp_path):
    touch(tmp_path, "f.0001.exr", "f.0010.exr", "f.12345.exr", "f.010.exr", "f.00012.exr", "f.abcd.exr", "g.0002.exr")
    assert existing_frames(str(tmp_path / "f.####.exr")) == [1, 10, 12345]
    assert existing_frames(str(tmp_path / "f.%03d.exr")) == [10, 12345]
    touch(tmp_path, "[a]1/f.exr", "[a]2/f.exr")
    assert existing_frames(str(tmp_path / "[a]#" / "f.exr")) == [1, 2]


def test_the_frames_of_a_sequence(tmp_path):
    front, back, out = (str(tmp_path / name) for name in ("front.##.exr", "back.exr", "out.##.exr"))
    touch(tmp_path, "front.01.exr", "front.02.exr", "front.05.exr", "back.exr", "camera.02.json")
    assert sequence_frames([front, back], [], out, None) == ([1, 2, 5], [3, 4])
    assert sequence_frames([front, back], [], out, "1-2") == ([1, 2], [])
    camera = str(tmp_path / "camera.##.json")
    with pytest.raises(InvalidFileError, match=r"front\.##\.exr: 4 frames are missing: 3-4, 6-7"):
        sequence_frames([front, back], [], out, "1-7")
    with pytest.raises(InvalidFileError, match=r"camera\.##\.json: 2 frames are missing: 1, 5"):
        sequence_frames([front, back], [camera], out, None)
    with pytest.raises(InvalidFileError, match="no such frames exist"):
        sequence_frames([str(tmp_path / "none.##.exr")], [], out, None)
    with pytest.raises(InvalidParameterError, match=r"the output .*back\.png needs a counter"):
        sequence_frames([front], [], str(tmp_path / "back.png"), None)


def test_long_lists_of_frames_are_cut():
    assert listed([1, 2, 3, 7, 9, 10]) == "1-3, 7, 9-10"
    assert listed(range(0, 100, 2)).endswith("36, 38, ...")


def test_a_run_makes_what_is_not_there_and_reports_each_frame(tmp_path):
    output = str(tmp_path / "out.#.exr")
    touch(tmp_path, "out.2.exr")
    made, steps = [], []

    def make(number, path):
        made.append((number, path))
        return {"ssim": 0.5}

    report = run_sequence([1, 2, 3], output, make, progress=lambda *step: steps.append(step))
    assert made == [(1, str(tmp_path / "out.1.exr")), (3, str(tmp_path / "out.3.exr"))]
    assert [(entry["frame"], entry["skipped"]) for entry in report["frames"]] == [(1, False), (2, True), (3, False)]
    assert report["frames"][2]["ssim"] == 0.5 and "ssim" not in report["frames"][1]
    assert (report["written"], report["skipped"]) == (2, 1) and steps == [(0, 3), (1, 3), (2, 3), (3, 3)]
    run_sequence([1, 2, 3], output, make, overwrite=True)
    assert [number for number, _ in made[2:]] == [1, 2, 3]


def test_a_run_goes_on_after_a_bad_frame_and_names_it(tmp_path):
    def make(number, path):
        if number == 4:
            raise InvalidFileError("no depth")
        return {}

    report = run_sequence([3, 4, 5], str(tmp_path / "out.#.exr"), make)
    assert (report["written"], report["failed"]) == (2, [4]) and report["frames"][1]["error"] == "no depth"


def test_an_error_that_is_no_frames_own_stops_and_says_which_frame(tmp_path):
    def make(number, path):
        raise InvalidParameterError("no such method")

    with pytest.raises(InvalidParameterError, match="frame 4: no such method"):
        run_sequence([4, 5], str(tmp_path / "out.#.exr"), make)
