import pytest
from rsmcm.apps.options.job import Address, read_address


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("8000", Address("127.0.0.1", 8000)),
        ("0", Address("127.0.0.1", 0)),
        ("0.0.0.0:8000", Address("0.0.0.0", 8000)),
        ("camera-box.lan:65535", Address("camera-box.lan", 65535)),
        ("[::1]:80", Address("::1", 80)),
    ],
)
def test_port_or_host_and_port(typed: str, meant: Address) -> None:
    assert read_address(typed) == meant


@pytest.mark.parametrize(
    "typed", ["", "http", "65536", "-1", ":8000", "1.2.3.4", "::1:80", "a b:1", "8000 ", "٨٠٠٠", "h:8000/x"]
)
def test_anything_else_is_refused_by_name(typed: str) -> None:
    with pytest.raises(ValueError, match=r"^--live: got .*, expected a port from 0 to 65535, or HOST:PORT$"):
        read_address(typed)
