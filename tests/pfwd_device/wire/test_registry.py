"""The dialects by name."""

import pytest

from pfwd_device.errors import SetupError
from pfwd_device.setup import DeviceSetup, read_device_setup
from pfwd_device.wire.registry import BUILT_IN, DEFAULT, all_dialects, dialect_names, find_dialect


def test_each_dialect_is_registered_under_its_name() -> None:
    for name, entry in BUILT_IN.items():
        assert find_dialect(name) is entry
        assert entry.name == name
    assert [entry.name for entry in all_dialects()][: len(BUILT_IN)] == list(BUILT_IN)
    assert dialect_names()[: len(BUILT_IN)] == tuple(BUILT_IN)


def test_the_default_dialect_is_the_binary_protocol() -> None:
    assert DEFAULT == "pfwd"
    assert DeviceSetup().make_dialect().name == "pfwd"


def test_an_unregistered_dialect_is_refused() -> None:
    assert find_dialect("morse") is None
    with pytest.raises(SetupError, match=r'dialect: expected "pfwd" or "ascii".*morse'):
        read_device_setup({"link": {"dialect": "morse"}}, "setup.toml")
    with pytest.raises(SetupError, match=r'dialect: expected "pfwd" or "ascii".*morse'):
        DeviceSetup(dialect="morse").make_dialect()
