"""Options from the command line and the environment, valid and invalid."""

import os
import re
from pathlib import Path

import command_line
import dipole
import pytest
from daemons import PROGRAM, REPOSITORY, run

# Maps each name to (default, least, most), as server/options.def has them.
NUMBERS = {
    name: (int(default), int(least), int(most))
    for name, default, least, most in re.findall(
        r'^SERVER_NUMBER\(\w+, "(.*?)", (\d+), (\d+), (\d+),',
        (REPOSITORY / "server/options.def").read_text(),
        re.M,
    )
}
NOWHERE = ["--listen", "tcp:127.0.0.1:0"]
LEVELS = {
    "portable": set(),
    "sse2": {"sse2"},
    "avx2": {"avx2", "fma"},
    "avx512": {"avx2", "fma", "avx512f", "avx512dq", "avx512vl"},
}
FLAGS = re.search(r"^flags.*?: (.*)", Path("/proc/cpuinfo").read_text() + "flags: ", re.M)[1]
HAS = [name for name, needed in LEVELS.items() if needed <= set(FLAGS.split())]
LACKS = [name for name in LEVELS if name not in HAS]


def variable(name: str) -> str:
    """Returns the option's name in the environment."""
    return "DIPOLED_" + name.upper().replace("-", "_")


def test_the_limits_in_hello_are_the_options(shared):
    with shared.client() as client:
        limits = {name.replace("_", "-"): value for name, value in client.info.limits.items()}
    assert limits == {name: default for name, (default, _, _) in NUMBERS.items()}
    assert len(limits) >= 9


def test_the_instruction_set_and_the_workers(daemon, shared):
    with daemon("--isa", "portable", "--workers", "5").client() as client, shared.client() as usual:
        assert (client.info.instruction_set, client.info.workers) == ("portable", 5)
        assert usual.info.instruction_set == HAS[-1]
    for isa in [*LACKS, "mmx", "AVX2", ""]:
        ended = run("--isa", isa, *NOWHERE)
        assert ended.returncode in (1, 2) and "isa" in ended.stderr


def test_the_command_line_wins_over_the_environment(daemon):
    env = {"DIPOLED_MAX_MEDIA": "3", "DIPOLED_ISA": "nonsense", "DIPOLED_MAX_FRAME_BYTES": "8192", "DIPOLED_WORKERS": "3"}
    options = ["--max-media", "5", "--isa", "portable", "--frame-timeout-ms=1234"]
    with daemon(*options, env=env).client() as client:
        limits = client.info.limits
        assert (limits["max_media"], limits["frame_timeout_ms"], limits["max_frame_bytes"]) == (5, 1234, 8192)
        assert limits["max_part_bytes"] == 8192  # parts are no larger than frames
        assert (client.info.instruction_set, client.info.workers) == ("portable", 3)


def test_addresses_from_the_environment(daemon, tmp_path_factory):
    folder = tmp_path_factory.mktemp("e")
    env = {"DIPOLED_LISTEN": f"unix:{folder}/a,unix:{folder}/b,tcp:127.0.0.1:0"}
    one = daemon(env=env, listen=[])
    assert one.urls[:2] == [f"unix:{folder}/a", f"unix:{folder}/b"]
    assert len(one.urls) == 3
    two = daemon(env={"DIPOLED_LISTEN": f"unix:{folder}/c"}, listen=["tcp:127.0.0.1:0"])
    assert [url[:4] for url in two.urls] == ["tcp:"]


SERVICE = {
    "SERVICE_HOST": "10.96.0.7",
    "SERVICE_PORT": "4817",
    "SERVICE_PORT_DIPOLE_TLS": "4818",
    "PORT": "tcp://10.96.0.7:4817",
    **{f"PORT_4817_{protocol}": "tcp://10.96.0.7:4817" for protocol in ("TCP", "UDP", "SCTP")},
    "PORT_4817_TCP_PROTO": "tcp",
    "PORT_4817_TCP_PORT": "4817",
    "PORT_4817_TCP_ADDR": "10.96.0.7",
}


@pytest.mark.parametrize("name", ["DIPOLED", "DIPOLED_METRICS", "DIPOLED_2"])
def test_what_kubernetes_sets_for_a_service_is_ignored(daemon, monkeypatch, name):
    env = {f"{name}_{key}": value for key, value in SERVICE.items()}
    with daemon(env=env).client() as client:
        assert client.info.limits["workers"] == NUMBERS["workers"][0]
    command_line.dipole("media", env=env)
    for key, value in env.items():
        monkeypatch.setenv(key, value)
    with dipole.Client(f"private:{PROGRAM}") as client:
        assert client.ping() > 0
        newest = int(Path("/proc/thread-self/children").read_text().split()[-1])
        assert os.getpgid(newest) == newest  # the interrupt key does not end it


def test_an_empty_variable_is_none(daemon):
    with daemon(env={"DIPOLED_MAX_MEDIA": ""}).client() as client:
        assert client.info.limits["max_media"] == NUMBERS["max-media"][0]


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_out_of_range(name):
    _, least, most = NUMBERS[name]
    beyond = [str(most + 1)] + ([str(least - 1)] if least > 0 else [])
    for value in beyond:
        ended = run(*NOWHERE, f"--{name}", value)
        assert ended.returncode == 2
        assert f"--{name}" in ended.stderr and str(least) in ended.stderr
        assert str(most) in ended.stderr and value in ended.stderr
        assert ended.stdout == ""
    ended = run(*NOWHERE, env={variable(name): beyond[0]})
    assert ended.returncode == 2 and name in ended.stderr
    assert f"that of the environment variable {variable(name)}\n" in ended.stderr


@pytest.mark.parametrize("end", [1, 2])
def test_numbers_at_the_ends_of_their_range(end):
    """Both ends of each range are accepted: the daemon complains only about the option after them."""
    numbers = [word for name, number in NUMBERS.items() for word in (f"--{name}", str(number[end]))]
    ended = run(*NOWHERE, *numbers, "--no-such-option")
    assert ended.returncode == 2 and "no-such-option" in ended.stderr
    assert not [name for name in NUMBERS if f"--{name}" in ended.stderr]


def test_log_level_error_is_quiet(daemon, tmp_path_factory):
    # A daemon that logs nothing listens at a socket that the test chose.
    path = tmp_path_factory.mktemp("q") / "s"
    quiet = daemon("--log-level", "error", listen=[f"unix:{path}"], quiet=True)
    with quiet.client() as client:
        client.ping()
    assert quiet.log == []
