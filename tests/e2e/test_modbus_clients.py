"""Modbus masters that others have made: each example of clients/modbus reads R at ten distances,
and other tools decode, identify and exercise the daemon."""

import contextlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import dipole
import numpy as np
import pytest
from daemons import BUILD, Daemon, eventually, finished
from installing import npm_install
from modbus_master import AT, BAD_VALUE, TCP, Tcp, exception, floats, input_block, words

TOP = Path(__file__).parents[2]
EXAMPLES = TOP / "clients/modbus"
SUITE = Path("/usr/share/doc/libmodbus-dev/examples/random-test-client.c")
RADII_MM = np.array([0.1, 0.2, 0.5, 1, 1.5, 2, 3, 4, 6, 8], np.float32)
# The packages that npm fetches, if npm is installed: versions that are known to work.
NODE_MODULES = {"modbus-serial": "8.0.25"}


def needs(program: str):
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"{program} is not installed")


@pytest.fixture(scope="module")
def address(slave) -> str:
    """Returns the HOST:PORT of the daemon's Modbus."""
    return slave.url("modbus-tcp").removeprefix("modbus-tcp:")


@pytest.fixture(scope="module")
def expected(slave):
    """Returns the answer of the binary protocol."""
    with slave.client() as client:
        medium = dipole.Medium(*np.array([0.032, 0.74, 0, 1.3], np.float32).astype(float))
        return client.eval("better", medium, RADII_MM, evaluator="f32").R[0]


@contextlib.contextmanager
def serial_line(folder: Path) -> Iterator[Path]:
    """Starts a daemon at one end of a pair of pseudo terminals. Returns the other end."""
    if shutil.which("socat") is None:
        pytest.skip("socat is not installed")
    near, far = folder / "near", folder / "far"
    link = subprocess.Popen(["socat", f"pty,raw,echo=0,link={near}", f"pty,raw,echo=0,link={far}"])
    try:
        assert eventually(lambda: near.exists() and far.exists())
        one = Daemon("--modbus", f"rtu:{near},19200,N")
        yield far
        one.close()
    finally:
        link.terminate()
        link.wait()


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    """Returns the master's end of a serial line as the examples take it."""
    with serial_line(tmp_path_factory.mktemp("line")) as far:
        yield f"{far},19200"


def values_of(output: str) -> np.ndarray:
    """Returns the numbers of lines such as `0.1 mm: 2.5 1/mm^2` and mbpoll's `[312]: 2.5`."""
    found = re.findall(r"(?:mm|\]): *\t? *([-+0-9.eE]+)", output)
    return np.array([float(text) for text in found])


def check(result: subprocess.CompletedProcess[str], expected: np.ndarray, digits: int) -> None:
    """Checks the output of an example. digits: how many digits it prints; 9 digits identify a
    float."""
    assert result.returncode == 0, result.stdout + result.stderr
    found = values_of(result.stdout)
    assert len(found) == 10, result.stdout
    if digits >= 9:
        np.testing.assert_array_equal(found.astype(np.float32), expected)
    else:
        assert [f"{x:.{digits}g}" for x in found] == [f"{x:.{digits}g}" for x in expected]


def check_model(result: subprocess.CompletedProcess[str], model: int = 2) -> None:
    """Checks the last line of an example: the model that was taken, and its error."""
    last = result.stdout.splitlines()[-1]
    found = re.fullmatch(r"model (\d+), model error (\S+) against radiative transport", last)
    assert found is not None and int(found[1]) == model and 0 < float(found[2]) < 1, last


# ---- reading R at ten distances ------------------------------------------------------------------


@needs("mbpoll")
@pytest.mark.parametrize("line", ["address", "serial"])
def test_mbpoll(request, line, expected):
    done = finished(str(EXAMPLES / "profile.sh"), request.getfixturevalue(line))
    check(done, expected, 6)
    check_model(done)


@needs("mbpoll")
def test_mbpoll_begins_with_function_6(tmp_path):
    """The daemon has not learned yet whether the adapter has an echo, so it sends its first answer
    with a pause in it."""
    with serial_line(tmp_path) as far:
        for value in ("77", "77", "78"):
            options = ["-m", "rtu", "-b", "19200", "-P", "none", "-a", "1", "-0", "-q", "-r", "5"]
            written = finished("mbpoll", *options, str(far), value)
            assert written.returncode == 0, written.stdout + written.stderr
            assert f"[5]: \t{value}" in finished("mbpoll", *options, "-1", str(far)).stdout


@pytest.mark.parametrize("line", ["address", "serial"])
def test_pymodbus(request, line, expected):
    pytest.importorskip("pymodbus")
    script = str(EXAMPLES / "profile.py")
    done = finished(sys.executable, script, request.getfixturevalue(line))
    check(done, expected, 9)
    check_model(done)
    tissue = ["29", "sigma_a=0.05", "sigma_s=9.5", "g=0.9", "eta=1.4", "r=0.1,1"]
    done = finished(sys.executable, script, request.getfixturevalue(line), *tissue)
    np.testing.assert_allclose(values_of(done.stdout), [0.14494, 0.016164], rtol=1e-3)


@pytest.fixture(scope="module")
def node_modules():
    """Returns the folder in which npm has installed what the JavaScript example needs."""
    return npm_install(BUILD / "node", NODE_MODULES) / "node_modules"


def test_node(address, expected, node_modules):
    environment = {**os.environ, "NODE_PATH": str(node_modules)}
    check(finished("node", str(EXAMPLES / "profile.js"), address, env=environment), expected, 9)


# ---- units that other masters have used ----------------------------------------------------------

# The digits that each example prints.
SCRIPTS = {"profile.sh": 6, "profile.py": 9, "profile.js": 9}
SLOW = {"model": 29, "evaluator": 3}


@pytest.fixture(params=SCRIPTS)
def example(request):
    """Returns a function that runs one of the examples, and the digits that the example prints."""
    name = request.param
    environment = dict(os.environ)
    if name.endswith(".js"):
        environment["NODE_PATH"] = str(request.getfixturevalue("node_modules"))
        command = ["node"]
    elif name.endswith(".py"):
        pytest.importorskip("pymodbus")
        command = [sys.executable]
    else:
        if shutil.which("mbpoll") is None:
            pytest.skip("mbpoll is not installed")
        command = ["sh"]
    command.append(str(EXAMPLES / name))
    return lambda *arguments: finished(*command, *arguments, env=environment), SCRIPTS[name]


ODD = {
    "only the albedo is wanted": [("WANTED", words(2))],
    "a slab": [("THICKNESS", floats(3.0)), ("MODEL", words(25))],
    "a tolerance in place of a model": [
        ("PARAMETER_TOLERANCE", floats(1e-12)), ("MODEL", words(0))
    ],
    "a grid and other moments": [
        ("MODEL", words(1, 1, 4)), ("SPACING", words(3, 50) + floats(1.0, 2.0))
    ],
    "a medium of g .9": [("SIGMA_A", floats(1.0, 20.0, 0.9, 1.5))],
}


@pytest.mark.parametrize("state", ODD)
def test_a_unit_in_an_odd_state(daemon, example, expected, state):
    """The state in which another master has left the unit does not change the output of the
    example."""
    one = daemon(*TCP)
    with Tcp(one) as master:
        master.write(100, input_block(1, radii=[1.0]))
        for field, data in ODD[state]:
            master.write(AT[field], data)
        with exception(BAD_VALUE):
            master.write(AT["ETA"], floats(0.0))
        ask, digits = example
        check(ask(one.url("modbus-tcp").removeprefix("modbus-tcp:")), expected, digits)


def test_a_unit_that_is_busy_and_a_model_that_takes_long(daemon, example):
    """The example waits for the other master's job, and then for its own."""
    one = daemon(*TCP)
    with Tcp(one) as master, one.client() as client:
        for unit in range(1, 9):  # Jobs of other units keep unit 1 busy for a while.
            medium = (0.01 * unit, 1.0, 0.0, 1.3)
            master.write(100, input_block(1, medium, [1.0], **SLOW), 9 - unit)
        ask, digits = example
        result = ask(one.url("modbus-tcp").removeprefix("modbus-tcp:"), "29")
        medium = dipole.Medium(*np.array([0.032, 0.74, 0, 1.3], np.float32).astype(float))
        answer = client.eval("transport", medium, RADII_MM, evaluator="f32")
        check(result, answer.R[0], digits)


def test_an_example_says_why_it_fails(daemon, example):
    """If the job fails, the example prints the daemon's text and ends with a status that is not
    0."""
    one = daemon(*TCP)
    ask, _ = example
    result = ask(one.url("modbus-tcp").removeprefix("modbus-tcp:"), "25")
    assert result.returncode != 0 and result.stdout == ""
    with Tcp(one) as master:
        text = master.read(AT["ERROR_TEXT"], 40).rstrip(b"\0").decode()
        assert text and f"error 6 at register {AT['THICKNESS']}: {text}" in result.stderr


# ---- the longer jobs -----------------------------------------------------------------------------


def job(one: Daemon, name: str) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("pymodbus")
    address = one.url("modbus-tcp").removeprefix("modbus-tcp:")
    return finished(sys.executable, str(EXAMPLES / "jobs.py"), address, name)


def test_the_jobs_of_an_odd_unit(daemon):
    """jobs.py prints the answers of the binary protocol, whatever was in the registers before."""
    one = daemon(*TCP)
    skin = np.array([0.032, 0.74, 0, 1.3], np.float32).astype(float)
    with Tcp(one) as master, one.client() as client:
        master.write(AT["MODEL"], words(29, 3, 2))
        master.write(AT["THICKNESS"], floats(5.0))
        master.write(AT["RADIUS_START"], floats(3.0, 4.0))
        master.write(AT["SAMPLE_DRAW"], words(4, 50, 1, 2, 3, 4))
        master.write(AT["INVERT_GIVEN"], words(3, 50))
        master.write(AT["MC_RING_COUNT"], words(50, 2) + floats(1e9) + words(8, 9))
        result = job(one, "sample")
        draw = dipole.Draw(10, "regular", 0)
        expected = client.sample("better", skin, evaluator="f32", draw=draw)
        assert result.returncode == 0, result.stderr
        found = re.findall(r"([\d.]+)% of .* within (\S+) mm", result.stdout)
        assert [text for _, text in found] == [f"{r:.6g}" for r in expected.r[0]]
        result = job(one, "invert")
        lengths = np.array([1.3, 0.95, 0.67], np.float32).astype(float)
        albedos = np.array([0.44, 0.22, 0.13], np.float32).astype(float)
        expected = client.invert("better", albedos, lengths, eta=skin[3])
        found = re.findall(r"sigma_a (\S+), sigma_s (\S+) 1/mm", result.stdout)
        pairs = zip(expected.sigma_a.astype("f4"), expected.sigma_s.astype("f4"))
        assert found == [(f"{a:.6g}", f"{s:.6g}") for a, s in pairs]
        result = job(one, "mc")
        edges = dipole.Grid(float(np.float32(0.1)), 10.0, 6, "logarithmic")
        expected = client.mc(skin, edges, photons=1_000_000)
        found = re.findall(r": (\S+) \+- (\S+) 1/mm", result.stdout)
        assert found == [
            (f"{R:.4g}", f"{error:.2g}")
            for R, error in zip(expected.R[0].astype("f4"), expected.R_error[0].astype("f4"))
        ]
        assert "%" in result.stderr


@pytest.fixture(scope="module")
def noisy_readings(slave) -> list[str]:
    """Readings that an instrument might take: Monte Carlo at four distances with 2 % noise, and an
    error that covers that of the walk. The medium has sigma_a .03, sigma_s' 1.2 and eta 1.4."""
    medium, readings = dipole.Medium(0.03, 1.2, 0.0, 1.4), []
    noise = np.random.default_rng(5).normal(0, 0.02, 4)
    with slave.client() as client:
        for r, off in zip([1.0, 2.0, 3.0, 5.0], noise):
            ring = client.mc(medium, dipole.Grid(0.95 * r, 1.05 * r, 2), photons=400_000)
            value, error = ring.R[0, 0], ring.R_error[0, 0]
            readings.append(f"{r},{value * (1 + off):.5g},{np.hypot(error, 0.02 * value):.3g}")
    return readings


def fit(address: str, *words: str) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("pymodbus")
    return finished(sys.executable, str(EXAMPLES / "jobs.py"), address, "fit", *words)


def test_instruments_fit_noisy_monte_carlo(address, noisy_readings):
    """Both coefficients come back within three of their standard errors."""
    result = fit(address, "eta=1.4", *noisy_readings)
    assert result.returncode == 0, result.stdout + result.stderr
    found = re.findall(r"(\S+) \+- ([^\s,]+)", result.stdout)
    (a, a_error), (s, s_error) = (map(float, pair) for pair in found)
    chi = float(re.search(r"chi-squared (\S+)", result.stdout)[1])
    assert "with g 0 (default), eta 1.4, scale absolute (default)\n" in result.stdout
    assert abs(a - 0.03) < 3 * a_error < 0.03 and abs(s - 1.2) < 3 * s_error < 0.6
    assert 0 < chi < 12


@pytest.mark.parametrize("name", ["jobs.py", *SCRIPTS])
def test_examples_know_their_words(request, address, name):
    """--help says how an example is called. An unknown word is refused by name, before any unit is
    asked: nothing is connected to."""
    tool = {"sh": "sh", "py": sys.executable, "js": "node"}[name.rpartition(".")[2]]
    environment = dict(os.environ)
    if tool == "node":
        environment["NODE_PATH"] = str(request.getfixturevalue("node_modules"))
    nobody = "127.0.0.1:1"

    def ask(*words: str) -> subprocess.CompletedProcess[str]:
        return finished(tool, str(EXAMPLES / name), *words, env=environment)

    for words in (["--help"], [nobody, "fit", "-h"]):
        told = ask(*words)
        assert told.returncode == 0 and told.stderr == "" and f"{name} HOST:PORT" in told.stdout
    wrong = {"": "", "localhost 2": "localhost", f"{nobody} -5": "-5"}
    wrong[f"{nobody} 2 3"] = "2 is" if name == "jobs.py" else "3"
    if name == "jobs.py":
        assert "scale=" in told.stdout
        readings = "1,.02,.001 2,.01,.001 3,.004,.0002"
        good, wrong[f"{nobody} fit {readings}"] = f"eta=1.4 {readings}", "give eta=X"
        for words in ("G=.9", "eta=", "eta=1,4", "scale=reference", "scale=", "1,.02", "1,2,3,4",
                      "1,x,3", "1,,3"):  # fmt: skip
            wrong[f"{nobody} fit {good} {words}"] = words
        wrong[f"{nobody} fit {good} g=.5 g=.6"] = "g= is given twice"
    if name == "profile.py":
        said_of = {"g=.5 g=.6": "given twice", "G=1": "unknown", "eta=x": "x: give", "r=,": ",: give"}
        wrong |= {f"{nobody} {words}": said for words, said in said_of.items()}
    for words, said in wrong.items():
        told = ask(*words.split())
        named = said if "twice" in said else said.rpartition("=")[0] or said
        assert told.returncode == 2 and told.stdout == "", (words, told)
        assert named in told.stderr and "Traceback" not in told.stderr, told
        assert f"{name} HOST:PORT" in told.stderr


def test_fits_say_what_they_took_and_scale(slave, address):
    """With scale=free, readings that are twice as large have the same coefficients."""
    at = np.array([0.5, 1, 2, 3, 5, 8])
    with slave.client() as client:
        R = client.eval("transport", (0.03, 12, 0.9, 1.35), at, wanted="R").R[0]
    readings = [f"{r},{2 * value:.7g},{0.02 * value:.7g}" for r, value in zip(at, R)]
    result = fit(address, "g=0.9", "eta=1.35", "scale=free", *readings)
    assert result.returncode == 0, result.stderr
    found = re.findall(r"(?:sigma_a |sigma_s' |factor )(\S+)", result.stdout)
    assert [float(text) for text in found] == pytest.approx([0.03, 1.2, 2], rel=2e-3)
    taken = dict(re.findall(r"\b(g|eta|scale) (\S+?)(?:,|\n| \(default\))", result.stdout))
    assert taken == {"g": "0.9", "eta": "1.35", "scale": "free"}
    assert "(default)" not in result.stdout
    usual = fit(address).stdout
    assert "with g 0 (default), eta 1.4, scale absolute (default)\n" in usual
    readings.append("20,-1e-5,2e-5")  # noise
    for g, end in (("0.9", 0), ("-0.4", 1)):  # A wrong g does not fit, but it gets there.
        result = fit(address, "eta=1.35", f"g={g}", "scale=free", *readings)
        assert result.returncode == end and ("implausible" in result.stderr) == bool(end), result


def test_instruments_are_told_what_is_no_success(address):
    """An error of 0 is named by its register; no medium has readings that rise with
    the distance."""
    wrong = {"1,.02,.001 2,.01,0": "error 6 at register 8210: a standard error above 0"}
    wrong["1,.001,.0001 2,.01,.001 4,.1,.01"] = "the fit is no success: implausible"
    for readings, said in wrong.items():
        result = fit(address, "eta=1.4", *readings.split())
        assert result.returncode == 1 and said in result.stderr, result.stderr


def test_a_job_that_is_refused_says_why(daemon):
    """A million photons are too many for this daemon."""
    one = daemon(*TCP, "--max-mc-photons", "1000")
    result = job(one, "mc")
    assert result.returncode == 1
    assert f"error 7 at register {AT['MC_PHOTONS']}: " in result.stderr


# ---- tools that judge ----------------------------------------------------------------------------


@needs("cc")
def test_libmodbus_random_test_client(address, tmp_path):
    """Debian's copy of the test client passes. Only its port is changed before it is compiled."""
    if not SUITE.exists():
        pytest.skip("libmodbus-dev's examples are not installed")
    port = address.rpartition(":")[2]
    elsewhere = tmp_path / "elsewhere.h"
    elsewhere.write_text(
        f"#include <modbus.h>\n#define modbus_new_tcp(ip, port) modbus_new_tcp(ip, {port})\n"
    )
    flags = finished("pkg-config", "--cflags", "--libs", "libmodbus").stdout.split()
    program = tmp_path / "random-test-client"
    compiled = finished("cc", "-include", str(elsewhere), str(SUITE), "-o", str(program), *flags)
    assert compiled.returncode == 0, compiled.stderr
    result = finished(str(program))
    assert "Test: SUCCESS" in result.stdout, result.stdout[-2000:]


@needs("nmap")
def test_nmap_prints_the_identification(slave, address):
    port = address.rpartition(":")[2]
    script = ["--script", "+modbus-discover"]
    result = finished("nmap", "-Pn", "-n", "-p", port, *script, "127.0.0.1")
    assert result.returncode == 0, result.stderr
    assert "Slave ID data" in result.stdout and "Device identification" in result.stdout
    with slave.client() as client:
        version = client.info.software.split()[-1]
    assert "dipoled" in result.stdout and version in result.stdout, result.stdout
