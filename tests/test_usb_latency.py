"""A USB adapter's latency timer is found by its port, and set where that is permitted."""

import os

import pytest

from controller.errors import RunError
from deploy.buses.usb_latency import shorten_timer, slow_timer


@pytest.fixture
def devices(tmp_path):
    folder = tmp_path / "devices" / "ttyUSB3"
    folder.mkdir(parents=True)
    (folder / "latency_timer").write_text("16\n")
    return folder.parent


def test_a_slow_adapter_is_found_through_a_link_and_set(devices, tmp_path):
    (tmp_path / "ttyUSB3").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB3")
    timer = slow_timer(str(tmp_path / "by-id"), devices)
    assert timer == devices / "ttyUSB3" / "latency_timer"
    shorten_timer(timer)
    assert timer.read_text() == "1\n"
    assert slow_timer(str(tmp_path / "ttyUSB3"), devices) is None


def test_a_port_without_such_a_timer_has_none(devices):
    assert slow_timer("/dev/pts/0", devices) is None
    assert slow_timer("socket://localhost:4000", devices) is None


def test_what_is_not_permitted_names_the_command(devices):
    timer = devices / "ttyUSB3" / "gone" / "latency_timer"
    with pytest.raises(RunError, match=rf"can not be set .*; run `echo 1 \| sudo tee {os.fspath(timer)}`"):
        shorten_timer(timer)
