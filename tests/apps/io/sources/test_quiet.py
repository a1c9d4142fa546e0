"""Decoders say nothing by themselves."""

import os
import threading
import zlib

import cv2
import numpy as np
import pytest
from rsmcm.apps.io.sources.quiet import quiet_libraries


def damaged_png() -> bytes:
    """A line filter that is none, under a correct check sum."""
    done = bytearray(cv2.imencode(".png", np.zeros((8, 8), np.uint8))[1])
    at = done.index(b"IDAT")
    length = int.from_bytes(done[at - 4 : at], "big")
    lines = bytearray(zlib.decompress(done[at + 4 : at + 4 + length]))
    lines[9] = 77
    packed = b"IDAT" + zlib.compress(lines)
    check_sum = zlib.crc32(packed).to_bytes(4, "big")
    return bytes(done[: at - 4]) + (len(packed) - 4).to_bytes(4, "big") + packed + check_sum + done[-12:]


def test_decoders_are_silent(capfd: pytest.CaptureFixture[str]) -> None:
    content = np.frombuffer(damaged_png(), np.uint8)
    with quiet_libraries():
        cv2.imdecode(content, cv2.IMREAD_COLOR)
        os.write(2, b"of a library\n")
    os.write(2, b"ours\n")
    assert capfd.readouterr().err == "ours\n"


def test_in_threads_and_after_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        for _ in range(50):
            with quiet_libraries():
                os.write(2, b"of a library\n")

    before = len(os.listdir("/dev/fd")) if os.path.isdir("/dev/fd") else 0
    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    with pytest.raises(ValueError, match="inside"), quiet_libraries():
        raise ValueError("inside")
    os.write(2, b"ours\n")
    assert capfd.readouterr().err == "ours\n"
    assert (len(os.listdir("/dev/fd")) if before else 0) == before
