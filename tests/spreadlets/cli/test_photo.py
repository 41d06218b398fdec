"""The command for photographs: which options go together."""

import numpy as np
from PIL import Image


def test_the_command_takes_the_focal_length_of_exif_only_with_an_f_number(tmp_path, run, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rgb = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 85
    Image.fromarray(rgb).save("a.png", exif=exif)
    np.save("depth.npy", np.where(np.arange(32) < 16, 2.0, 8.0) * np.ones((24, 1)))
    words = ("photo", "a.png", "depth.npy", "-o", "out.png", "--focus", "4,12", "--depth-kind", "metric")
    assert run(*words)[0] == run(*words, "--f-number", "2")[0] == 0
    for bad, message in (
        (("--focal-length", "50"), "--focal-length is for --f-number"),
        (("--f-number", "2", "--focal-length", "0"), "focal_length_mm is 0"),
        (("--f-number", "2", "--blur", "4"), "--blur and --f-number exclude each other"),
    ):
        status, _, err = run(*words, *bad)
        assert status == 2 and message in err and err.count("\n") == 1
