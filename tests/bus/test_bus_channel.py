"""The names of local buses."""

from pathlib import Path

import pytest

from meshpoint.bus.local.channel import (
    ChannelError,
    TcpChannel,
    UnixChannel,
    default_channel,
    parse_channel,
    private_directory,
)


@pytest.mark.parametrize("text", ["unix:/tmp/a.sock", "tcp:127.0.0.1:29536", "tcp:[::1]:1"])
def test_a_channel_is_read_as_it_is_written(text: str) -> None:
    assert str(parse_channel(text)) == text


@pytest.mark.parametrize(
    "text",
    [
        *("", "0", "vcan0", "unix:", "unix:/" + "x" * 120),
        *("tcp:", "tcp:localhost", "tcp:localhost:x", "tcp:a:0", "tcp:a:70000"),
    ],
)
def test_what_is_no_channel_is_refused_by_name(text: str) -> None:
    with pytest.raises(ChannelError, match=repr(text)[1:-1] if text else "''"):
        parse_channel(text)


def test_only_this_machines_addresses_are_local() -> None:
    assert all(TcpChannel(host, 1).is_local for host in ("localhost", "127.0.0.1", "::1"))
    assert not any(TcpChannel(host, 1).is_local for host in ("0.0.0.0", "192.0.2.1", "bench"))


def test_a_relative_path_is_made_absolute() -> None:
    channel = parse_channel("unix:a.sock")
    assert isinstance(channel, UnixChannel)
    assert channel.path.is_absolute()


def test_the_default_directory_is_refused_when_others_can_enter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    directory = private_directory()
    assert directory.parent == tmp_path
    assert default_channel() == UnixChannel(directory / "default.sock")
    directory.chmod(0o755)
    with pytest.raises(ChannelError, match="nobody else"):
        default_channel()
