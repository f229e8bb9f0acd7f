"""Opening a bus from the command line, environment and configuration files."""

import argparse
from pathlib import Path

import can
import pytest

from meshpoint.bus.options import (
    BusOpenError,
    add_bus_arguments,
    bus_config,
    is_local_bus,
    open_bus_from,
)
from meshpoint.cli.main import main


@pytest.fixture(autouse=True)
def nothing_configured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("can.util.CONFIG_FILES", [str(tmp_path / "can.conf")])
    monkeypatch.setattr("can.rc", {})


def parsed(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser)
    return parser.parse_args(arguments)


def test_without_anything_asked_for_it_is_this_users_local_bus(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert bus_config(parsed()) == {"interface": "meshpoint"}
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(place))
    with open_bus_from(parsed()) as bus:
        assert "default.sock" in bus.channel_info


def test_arguments_win_over_section_environment_and_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "can.conf").write_text(
        "[default]\ninterface = virtual\nchannel = file\nbitrate = 1\n"
        "[bench]\ninterface = virtual\nchannel = usual section\n"
    )
    own = tmp_path / "own.conf"
    own.write_text("[default]\nchannel = own default\n[rig]\ninterface=virtual\nchannel = own\n")
    assert bus_config(parsed())["channel"] == "file"
    monkeypatch.setenv("CAN_CHANNEL", "environment")
    assert bus_config(parsed())["channel"] == "environment"
    assert bus_config(parsed("--config", "bench"))["channel"] == "usual section"
    assert bus_config(parsed("--config", f"{own}/rig"))["channel"] == "own"
    assert bus_config(parsed("--config", str(own)))["channel"] == "own default"
    argument = bus_config(parsed("--config", f"{own}/rig", "-c", "argument"))
    assert argument["channel"] == "argument"
    assert argument["bitrate"] == 1


def test_what_is_configured_for_another_interface_does_not_count(tmp_path: Path) -> None:
    (tmp_path / "can.conf").write_text("[default]\ninterface = socketcan\nchannel = can0\n")
    assert bus_config(parsed("-i", "meshpoint")) == {"interface": "meshpoint"}


def test_can_fd_is_on_where_an_interface_has_it() -> None:
    assert bus_config(parsed("-i", "kvaser", "-c", "0"))["fd"] is True
    udp = bus_config(parsed("-i", "udp_multicast", "--bus-kwargs", "port=12345"))
    assert udp["fd"] is True
    assert udp["hop_limit"] == 0
    assert udp["port"] == 12345
    assert "fd" not in bus_config(parsed("-i", "slcan", "-c", "/dev/ttyACM0"))
    assert bus_config(parsed("-i", "slcan", "-c", "/dev/ttyACM0", "--fd"))["fd"] is True


def test_bit_timing_reaches_the_interface() -> None:
    timing = ["f_clock=8000000", "tseg1=5", "tseg2=2", "sjw=2", "brp=2", "nof_samples=1"]
    config = bus_config(parsed("-i", "virtual", "-c", "x", "--timing", *timing))
    assert isinstance(config["timing"], can.BitTiming)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-c", "vcan0"], "channel 'vcan0' is not unix:.* or tcp:.*add -i"),
        (["-i", "socketcan"], "socketcan needs a channel"),
        (["-i", "socketcan", "-c", "nocan7"], "interface socketcan, channel nocan7"),
        (["-i", "slcan"], "interface slcan.*needs a channel"),
        (["--config", "nowhere"], "--config nowhere: neither a file nor a section"),
        (["--config", "/no/such/file"], "there is no file /no/such"),
        (["-c", "tcp:192.0.2.1:5"], "another machine"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_one_clear_line(
    arguments: list[str], said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(BusOpenError, match=said) as caught:
        open_bus_from(parsed(*arguments)).shutdown()
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_an_unknown_interface_is_refused_with_the_known_ones(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        parsed("-i", "nonsense")
    assert "meshpoint" in capsys.readouterr().err
    monkeypatch.setenv("CAN_INTERFACE", "nonsense")
    with pytest.raises(BusOpenError, match=r"nonsense.*known interfaces.*meshpoint.*socketcan"):
        open_bus_from(parsed())


@pytest.mark.parametrize(
    "content", ["interface = virtual\n", "[a]\n[a]\n", "[default]\nx = %(y)s\n", "[other]\nx=1\n"]
)
def test_a_configuration_file_that_is_none_is_refused(tmp_path: Path, content: str) -> None:
    file = tmp_path / "bad.conf"
    file.write_text(content)
    with pytest.raises(BusOpenError, match=r"bad\.conf|'y'"):
        open_bus_from(parsed("--config", str(file)))


def test_an_environment_that_is_no_json_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAN_CONFIG", "{fd:")
    with pytest.raises(BusOpenError, match="bus configuration"):
        open_bus_from(parsed())


def test_a_classic_device_is_refused_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "can0").mkdir()
    (tmp_path / "can0" / "mtu").write_text("16\n")
    monkeypatch.setattr("meshpoint.bus.options._NET_DEVICES", tmp_path)
    with pytest.raises(
        BusOpenError, match=r"can0 is set up for classic CAN.*fd on.*--profile classic"
    ):
        open_bus_from(parsed("-i", "socketcan", "-c", "can0"))


def test_a_classic_device_is_taken_with_the_classic_profile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And no CAN FD is asked for, of any interface that has it otherwise."""
    (tmp_path / "can0").mkdir()
    (tmp_path / "can0" / "mtu").write_text("16\n")
    monkeypatch.setattr("meshpoint.bus.options._NET_DEVICES", tmp_path)
    chosen = parsed("-i", "socketcan", "-c", "can0")
    chosen.wire = "classic"
    assert bus_config(chosen) == {"interface": "socketcan", "channel": "can0", "fd": False}


def test_a_bus_that_python_can_leaves_unknown_gets_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """As udp_multicast: a node then says on which group it is."""

    class Nameless(can.BusABC):
        def __init__(self, channel: object = None, **_: object) -> None:
            super().__init__(channel=channel)

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            raise AssertionError(msg)

    monkeypatch.setattr(can, "Bus", lambda **config: Nameless(config.get("channel")))
    with open_bus_from(parsed("-i", "neovi", "-c", "7")) as bus:
        assert bus.channel_info == "neovi channel 7"
    monkeypatch.setattr("meshpoint.bus.options._enlarge_receive_buffer", lambda _: None)
    with open_bus_from(parsed("-i", "udp_multicast", "--bus-kwargs", "port=12345")) as bus:
        assert bus.channel_info == "udp_multicast channel 239.74.163.2, port 12345"
    with open_bus_from(parsed("-i", "udp_multicast")) as bus:
        assert bus.channel_info == "udp_multicast channel 239.74.163.2"


@pytest.mark.parametrize(
    ("arguments", "local"),
    [
        ("", True),
        ("-i virtual -c x", True),
        ("-i meshpoint -c unix:/tmp/x.sock", True),
        ("-i meshpoint -c tcp:127.0.0.1:29600", True),
        ("-i meshpoint -c tcp:192.168.1.7:29600", False),
        ("-i udp_multicast", False),
        ("-i kvaser -c 0", False),
    ],
)
def test_only_a_bus_of_this_machine_is_local(arguments: str, local: bool) -> None:
    assert is_local_bus(parsed(*arguments.split())) is local


@pytest.mark.parametrize(
    ("interface", "driver"),
    [
        ("kvaser", "CANlib"),
        ("pcan", "PCAN-Basic"),
        ("vector", "XL Driver Library"),
        ("ixxat", "VCI"),
        ("neovi", "python-ics"),
        ("nixnet", "NI-XNET"),
        ("iscan", "isCAN"),
        ("usb2can", "USB2CAN"),
        ("etas", "BOA"),
    ],
)
def test_an_adapter_without_its_driver_is_told_by_the_drivers_name(
    interface: str, driver: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """No machine that runs tests has these drivers; PCAN's, where it is, has no device 0."""
    assert main(["request", "10", "-i", interface, "-c", "0"]) == 2
    said = capsys.readouterr().err
    assert f"cannot open interface {interface}, channel 0: " in said
    assert driver in said
    assert "not defined" not in said
    assert "Cannot import" not in said


def test_whatever_a_backend_misses_by_name_is_its_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    def opened(**_: object) -> can.BusABC:
        raise NameError("name 'vendorOpen' is not defined")

    monkeypatch.setattr(can, "Bus", opened)
    with pytest.raises(BusOpenError, match=r"slcan.*its driver is not on this machine$"):
        open_bus_from(parsed("-i", "slcan", "-c", "/dev/ttyACM0"))


def test_a_bus_that_a_file_asks_for_is_not_local(tmp_path: Path) -> None:
    (tmp_path / "can.conf").write_text("[default]\ninterface = kvaser\nchannel = 0\n")
    assert not is_local_bus(parsed())
