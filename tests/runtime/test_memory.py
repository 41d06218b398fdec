import math
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from spreadlets.runtime import memory
from spreadlets.runtime.memory import BYTES_PER_MB, peak_rss_mb

STATUS = Path("/proc/self/status")


@pytest.mark.skipif(not STATUS.exists(), reason="only Linux tells it in a second place")
def test_peak_is_what_the_system_says_elsewhere():
    peak_kib = int(re.search(r"VmHWM:\s*(\d+) kB", STATUS.read_text()).group(1))
    assert peak_rss_mb() == pytest.approx(peak_kib / 1024, rel=0.02)


def test_without_the_module_resource_windows_is_asked(monkeypatch):
    held = SimpleNamespace(peak_wset=3 * BYTES_PER_MB)
    process = SimpleNamespace(Process=lambda: SimpleNamespace(memory_info=lambda: held))
    monkeypatch.setattr(memory, "resource", None)
    monkeypatch.setitem(sys.modules, "psutil", process)
    assert peak_rss_mb() == 3.0
    monkeypatch.setitem(sys.modules, "psutil", None)
    assert math.isnan(peak_rss_mb())
