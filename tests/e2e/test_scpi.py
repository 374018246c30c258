"""SCPI: its documented client, the bits of the binary protocol, real *OPC and *WAI, and streams that
clients should not send."""

import re
import select
import socket
import struct
import threading
import time

import numpy as np
import pytest
from daemons import HANG_S, REPOSITORY, Daemon, eventually, read_log_line
from dipole import Grid, Medium, Stack

pyvisa = pytest.importorskip("pyvisa")

SCPI = ("--scpi", "127.0.0.1:0")
TISSUE = Medium(0.05, 9.5, 0.9, 1.4)
MED = "MED 0.05,9.5,0.9,1.4"
# Hours of work, for tests that need a job that runs.
ENDLESS = "MED 1E-4,10,0.9,1.4;:MC:PHOT 1E10;RINGs 0,5,5;STARt"
NO_ERROR = '0,"No error"'
PAGE = (REPOSITORY / "proto/SCPI.md").read_text()


class Raw:
    """A client that says what it sends byte by byte."""

    def __init__(self, daemon: Daemon):
        port = int(daemon.url("scpi").rsplit(":", 1)[1])
        self.socket = socket.create_connection(("127.0.0.1", port), HANG_S)
        self.file = self.socket.makefile("rb")

    def __enter__(self) -> "Raw":
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()
        self.socket.close()

    def send(self, *messages: str) -> None:
        self.socket.sendall("".join(f"{one}\n" for one in messages).encode())

    def line(self) -> str:
        return self.file.readline().decode().removesuffix("\n")

    def ask(self, message: str) -> str:
        self.send(message)
        return self.line()

    def error(self, message: str) -> str:
        """Returns the one error of a message."""
        self.send(message)
        error, none = self.ask("SYST:ERR?;ERR?").split(";0,")
        assert none == '"No error"'
        return error

    def numbers(self, message: str) -> list[float]:
        return [float(one) for one in self.ask(message).split(",")]


@pytest.fixture(scope="module")
def shared():
    one = Daemon(*SCPI)
    yield one
    one.close()


@pytest.fixture
def raw(shared):
    with Raw(shared) as one:
        yield one


@pytest.fixture(scope="module")
def visa(shared):
    """The session of the page's one-liner."""
    call = re.search(r"open_resource\(\s*(.*?)\)\n", PAGE, re.S)[1]
    call = call.replace("127.0.0.1::5025", shared.url("scpi").removeprefix("scpi:").replace(":", "::"))
    resource, options = call.split(", ", 1)
    manager = pyvisa.ResourceManager("@py")
    session = manager.open_resource(eval(resource), **eval(f"dict({options})"))
    session.timeout = 1000 * HANG_S
    yield session
    session.close()
    manager.close()


# ---- the page ------------------------------------------------------------------------------------

GIVEN = {
    "*ESE": "60", "*SRE": "4", "STATus:OPERation:ENABle": "16", "STATus:QUEStionable:ENABle": "512",
    "MEDium[:COEFficients]": "0.05,9.5,0.9,1.4,0", "MEDium:LAYer<n>": "0.1,9,0.9,1.4,2",
    "MEDium:NAME": "skin1", "MEDium:CHANnel": "3", "MODel": "transport", "TOLerance": "0.01",
    "EVALuator": "f64", "FIT:PLACes": "1,2,4", "FIT:READings": "0.013,0.0045,0.0008",
    "FIT:ERRors": "1e-4,1e-5,1e-5", "FIT:AXIS": "r", "FIT:SCALe": "free", "FIT:MODel": "better",
    "FIT:REFerence": "0.1,9,0.9,1.4,0", "MEDium:TISSue": "liver", "MEDium:PROPerty": "HB_UM,10",
    "MEDium:TABLe": "ucl", "MEDium:WAVelength": "650", "MC:PHOTons": "8192", "MC:RINGs": "0,5,2",
    "MC:SPACing": "linear", "MC:SEED": "7", "MC:TARGet": "0.5", "R:DATA": "0.5,1", "R": "0.5,1",
    "R:FREQuency": "0,0.1", "T": "0.5,1", "PATH": "2,20",
    "PATH:DPF": "20", "PATH:TIME": "20", "PHASe:FREQuency": "100", "PHASe": "20", "PHASe:MODulation": "20",
    "PHASe:STRipes": "0.1", "PHASe:MODulation:STRipes": "0.1", "FIT:SPECtrum:WAVelengths": "760",
    "FIT:SPECtrum:UNKNown": "HBO2_UM,HB_UM", "FIT:SPECtrum:LIMit": "HB,0,500", "FIT:SPECtrum:MHZ": "0,0,0",
    "FIT:SPECtrum:QUANtities": "0,0,0", "FORMat[:DATA]": "ASC", "FORMat:BORDer": "SWAP",
}  # fmt: skip


def alike(told: str, given: str) -> bool:
    """Returns whether an answer has the words and numbers that were set."""
    values = lambda text: [float(one) if one[0].isdigit() else one.lower() for one in text.strip('"').split(",")]
    return values(told) == values(given)


def test_every_command_of_the_page(visa):
    """In its short form, with what it takes. What is set is told. No command has an error."""
    rows = re.findall(r"^\| `([^`]*?)( \(\?\)|\?|)` \|", PAGE.split("tables: begin")[1], re.M)
    visa.write("*RST;*CLS")
    assert re.fullmatch(r"dipoled,dipoled,0,[\d.]+", visa.query("*IDN?"))
    assert visa.query("*TST?;:SYST:VERS?") == "0;1999.0"
    for name, mark in rows:
        short = re.sub(r"\[.*?\]|[a-z]|<n>", "", name)
        given = GIVEN.get(name, "") if (name, mark) != ("R:DATA", "?") else ""
        given = given.split(",")[0] if (short, mark) == ("MED:PROP", "?") else given
        if mark != "?":
            visa.write(f"{short} {given}")
        if short in ("FIT", "FIT:SPEC", "MC:STAR"):
            assert visa.query("*OPC?") == "1"
        if mark == " (?)":
            assert alike(visa.query(f"{short}?"), given), name
        elif mark == "?":
            assert visa.query(f"{short}? {given}") not in ("", '""')
        assert visa.query("SYST:ERR?") == NO_ERROR, name


def test_what_is_set_again_changes_nothing_else(visa):
    names = re.findall(r"^\| `([^`]*?) \(\?\)` \|", PAGE.split("tables: begin")[1], re.M)
    commands = [f"MED:LAY{n} {GIVEN['MEDium:LAYer<n>']}" for n in (1, 2, 3)] + [
        re.sub(r"\[.*?\]|[a-z]", "", name) + f" {GIVEN[name]}" for name in names if name[:3] != "MED"]
    told = lambda: visa.query(";:".join(one.split()[0] + "?" for one in commands))
    visa.write("*RST;*CLS;:" + ";:".join(commands))
    before = told()
    for one in commands:
        visa.write(one)
        assert told() == before, one
    assert visa.query("SYST:ERR?") == NO_ERROR


def test_long_and_short_forms(raw):
    """Case, colons, blanks, nodes, ends of lines."""
    for message in ("FORMat:DATA REAL,32", ":form:data real,32", "FORM REAL , 32", "form\treal,32\r"):
        raw.send("*RST", message)
        assert raw.ask("FORM?") == "REAL,32"
    assert raw.ask(f"{MED}; LAYer?;NAME?;*STB?;LAY1?;:FORM REAL,64;BORD SWAP;BORD?;;:TOL 1E-3;TOL?") == (
        '0.05,9.5,0.9,1.4,0;"";16;0.05,9.5,0.9,1.4,0;SWAP;1e-3'
    )
    assert raw.ask("med:name 'SKIN1';chan 2;chan?;:STAT:OPER?;ENAB 1;ENAB?") == "2;0;1"
    assert raw.ask("MC:PHOT DEF;PHOT?;:MED MIN,MAX,0,1;:MED?") == "1000000;0,1e15,0,1,0"
    assert raw.ask("*RST;TOL?;:MED:TISS?") == "OFF;AUTO"
    for message, error in [
        ("FORMA REAL,64", '-113,"Undefined header;FORMA"'),
        ("MED:NAME SKIN1;TOL 1", '-113,"Undefined header;TOL"'),
        ("MED 1,2,3", '-109,"Missing parameter"'),
        ("MED 1,2,0.5,1.4,0,1", '-108,"Parameter not allowed"'),
        ("*CLS 1", '-108,"Parameter not allowed"'),
        ("R? 1 2", '-103,"Invalid separator"'),
        ("MED:WAV 850 nm", '-131,"Invalid suffix"'),
        ("R? 1,,2", '-109,"Missing parameter"'),
        ("R? 1.2.3", '-121,"Invalid character in number"'),
        ("R? 1e400", '-222,"Data out of range"'),
        ("R? 1e-32001", '-123,"Exponent too large"'),
        (f"R? {'1' * 300}", '-124,"Too many digits"'),
        ("R? one", '-104,"Data type error"'),
        ('MED:NAME "skin1', '-151,"Invalid string data"'),
        ("R:DATA #2x", '-161,"Invalid block data"'),
        ("R:DATA #11x", '-161,"Invalid block data;FORMat: REAL,32 or REAL,64, as the numbers of the block"'),
        ("MC:PHOT 1.5", '-222,"Data out of range;photons: an integer from 0 on, below 2^53 and as large as the field"'),
        ("*ESE 65536", '-222,"Data out of range;*ESE: an integer from 0 on, below 2^53 and as large as the field"'),
        ("MED:LAY3 1,1,0,1", '-221,"Settings conflict;MEDium: a layer that there is, or the next one, up to 8"'),
        ("MED:NAME X", '-224,"Illegal parameter value;MEDium:NAME: a name that `dipole media` lists"'),
        (f"{MED};CHAN 2", '-221,"Settings conflict;MEDium:CHANnel: behind MEDium:NAME"'),
        ("FORM REAL,16", '-224,"Illegal parameter value;FORMat: ASCii, REAL,32 or REAL,64"'),
        (f"{MED};LAY2 1,1,0,1;:FIT", '-221,"Settings conflict;MEDium: one layer: its g, eta and thickness"'),
        ("FIT:SPEC:MHZ 1;:FIT:SPEC", '-226,"Lists not same length;FIT:SPECtrum[:IMMediate]: MHZ and QUANtities as PLACes"'),
        ("MC:PROG?", '-230,"Data corrupt or stale;MC:PROGress: when MC:STARt has begun"'),
        ("MED 0.05,9.5,2,1.4;:R? 1", '-222,"Data out of range;g: between -1 and 1, exclusive"'),
        (f"{MED};:MOD BETT;:R? 1", '-224,"Illegal parameter value;model: '),  # of several
        (f"{MED};:MOD NONE;:R? 1", '-224,"Illegal parameter value;model: '),
        (f"{MED};:EVAL 4;:R? 1", '-222,"Data out of range;evaluator: one of 1 (f64), 2 (f32), 3 (lut)"'),
        ("R? 1", '-221,"Settings conflict;MEDium: '),
        ("MED?", '-221,"Settings conflict;MEDium: a medium, which has no default"'),
        ("FIT:RES?", '-230,"Data corrupt or stale;'),
        ("MC:RING 0,5,0", '-222,"Data out of range;ring_count: '),
        (f"{MED};:FIT:PLAC 1,2;READ 1;ERR 1,1;:FIT", '-226,"Lists not same length;'),
    ]:
        raw.send("*RST")
        assert raw.error(message).startswith(error), message


def test_what_else_a_command_changes(raw):
    """One that fails leaves all as it was."""
    raw.send("*RST;*CLS")
    for message, error, question, told in [
        (f"{MED};:TOL 0.01", 0, "TOL?;:MED?", "0.01;0.05,9.5,0.9,1.4,0"),
        ("TOL 2", -222, "TOL?", "0.01"),
        ("MED 0,9.5,2,1.4", -222, "MED?", "0.05,9.5,0.9,1.4,0"),
        ("MED:NAME SKIN1", 0, "MED:NAME?", "skin1"),
        ("MED:TISS LIVer;WAV 800", 0, "MED:NAME?", '""'),
        (f"MED:NAME SKIN1;:{MED}", 0, "MED:NAME?", '""'),
        ("PHAS:FREQ 100;:MOD BURLEY;:TOL OFF", 0, "PHAS:FREQ?;:R? INF", "100;0"),
        ("FIT:READ NINF,INF,NAN", 0, "FIT:READ?", "-9.9E37,9.9E37,9.91E37"),
        ("*RST", 0, "FIT:READ?;:TOL?", '"";OFF'),
        ("STAT:OPER:ENAB 16;:STAT:QUES:ENAB 8;:STAT:PRES", 0, "STAT:OPER:ENAB?;:STAT:QUES:ENAB?", "0;0"),
        ("MED 0,1,0,1.4,3;:FIT:MOD better;PLAC 1,2;READ 1,1;ERR 1,1;:FIT;*WAI", -222, "FIT:MOD?", "better"),
    ]:
        raw.send(message)
        assert raw.ask(f"{question};:SYST:ERR?").startswith(f"{told};{error},"), message


# ---- values --------------------------------------------------------------------------------------


@pytest.mark.parametrize("evaluator", ["f64", "f32", "lut"])
def test_the_bits_are_those_of_the_binary_protocol(shared, visa, evaluator):
    radii = np.geomspace(1e-3, 300, 301)
    with shared.client() as client:
        known = client.eval("transport", TISSUE, radii, evaluator=evaluator, wanted=["R", "albedo"])
    visa.write(f"*RST;:{MED};:EVAL {evaluator}")
    listed = ",".join(map(repr, radii.tolist()))
    told = np.array(visa.query_ascii_values(f"R? {listed}"), known.R.dtype)
    assert known.R[0].tolist() == told.tolist()
    assert known.albedo[0] == float(visa.query("ALB?"))
    for big in (True, False):
        visa.write(f"FORM REAL,64;BORD {'NORM' if big else 'SWAP'}")
        visa.write_binary_values("R:DATA ", radii, datatype="d", is_big_endian=big)
        told = visa.query_binary_values("R:DATA?", datatype="d", is_big_endian=big)
        assert known.R[0].astype(float).tolist() == told
        visa.write("FORM REAL,32")
        told = visa.query_binary_values("R:DATA?", datatype="f", is_big_endian=big)
        assert known.R[0].astype("f4").tolist() == told
    assert visa.query("SYST:ERR?") == NO_ERROR


def test_errors_of_values_are_known(shared, raw):
    with shared.client() as client:
        known = client.eval("better", TISSUE, [1.0], wanted="R", model_error=True)
    raw.send(f"{MED};:MOD better;:EVAL F64")
    assert raw.ask("R? 1") == repr(float(known.R[0, 0]))
    assert raw.numbers("R:ERR?")[2] == known.model_error[0]


def test_path_lengths_and_modulated_light(shared, raw):
    """By a random walk, of rings from 19 to 21 mm, and by diffusion with its ratio to transport."""
    raw.send("MED 0.01,1,0,1.4;:EVAL F64;:PHAS:FREQ 100")
    path, dpf, time_ps = map(float, raw.ask("PATH? 20;:PATH:DPF? 20;TIME? 20").split(";"))
    assert path == pytest.approx(138.3, abs=1) and dpf == pytest.approx(path / 20)
    assert time_ps == pytest.approx(1.4 * path / 0.299792458, rel=1e-6)
    assert raw.numbers("PHAS? 20")[0] == pytest.approx(23.18, abs=0.1)
    assert raw.numbers("PHAS:MOD? 20")[0] == pytest.approx(0.9779, abs=0.0005)
    assert all(one < 0.1 for one in raw.numbers("R:ERR?")) and raw.numbers("R? 20")[0] > 0
    with shared.client() as client:
        known = client.eval("transport", Medium(0.01, 1, 0, 1.4), [0.02, 0.1], evaluator="f64",
                            wanted=["phase_f", "modulation_f", "balance"], parameters={"mhz": 100})  # fmt: skip
    assert raw.numbers("PHAS:STR? 0.02,0.1") == known.phase_f[0].tolist()
    assert raw.numbers("PHAS:MOD:STR? 0.02,0.1") == known.modulation_f[0].tolist()
    balance = raw.numbers("BAL?")
    assert sum(balance) == pytest.approx(1, abs=1e-3) and balance[0] == float(raw.ask("ALB?"))


def test_layers_slabs_and_frequencies(shared, raw):
    """And an empty list, which is no empty line; and infinity."""
    with shared.client() as client:
        slab = client.eval("transport", Medium(0.1, 2, 0, 1.4, 3), [1.0], evaluator="lut", wanted=["T"])
        skin = client.eval("transport", "skin1", [1.0], evaluator="lut")
    assert np.float32(raw.ask("MED 0.1,2,0,1.4,3;:T? 1")) == slab.T[0, 0]
    assert np.float32(raw.ask("MED:NAME SKIN1;CHAN 3;:R? 1")) == skin.R[2, 0]
    assert raw.ask("MED:NAME SKIN1;CHAN 3;NAME SKIN1;CHAN?") == "1"
    layered = raw.ask("MED 0.1,2,0,1.4,1;LAY2 0.05,1,0,1.4;LAY2?;:R? 1").split(";")
    assert layered[0] == "0.05,1,0,1.4,0" and 0 < float(layered[1]) < 1
    albedo, at_0 = raw.ask("MED 0.1,2,0,1.4;:EVAL F64;:ALB?;:R:FREQ? 0").split(";")
    assert float(at_0) == pytest.approx(float(albedo), rel=1e-6)
    with shared.client() as client:
        liver = client.tissue([1000], "liver", {"hb_uM": 100})[0]
    told = raw.numbers("MED:TISS LIVer;PROP hb_um,100;WAV 1000;:MED?")
    assert told == [liver.sigma_a, liver.sigma_s, liver.g, liver.eta, 0]
    assert "wavelength" in raw.error("MED:WAV 100") and raw.numbers("MED:WAV?") == [1000] and raw.numbers("MED?") == told
    assert raw.ask("R:DATA?") == '""' and raw.ask("FORM REAL,64;:R:DATA?") == "#10"
    assert raw.numbers("FORM ASC;:R? 0")[0] == 9.9e37


# ---- jobs ----------------------------------------------------------------------------------------


def test_a_fit(shared, raw):
    at, sigma_a = [0.5, 1.0, 2.0, 4.0, 8.0], 0.05
    with shared.client() as client:
        readings = client.eval("transport", TISSUE, at).R[0]
        known = client.fit("transport", at, readings, 0.01 * readings, eta=1.4, g=0.9)
    given = [",".join(map(repr, list(map(float, one)))) for one in (at, readings, 0.01 * readings)]
    raw.send("MED 0,1,0.9,1.4;:FIT:PLAC {};READ {};ERR {}".format(*given))
    told = raw.numbers("FIT;*WAI;RES?")
    assert told[0] == known.sigma_a == pytest.approx(sigma_a, rel=1e-4)
    assert told[1:4] == [known.sigma_s_prime, known.sigma_a_error, known.sigma_s_prime_error]
    assert told[5] == 1 and raw.ask("STAT:QUES:COND?") == "0"
    assert raw.numbers("FIT:COV?")[0] == pytest.approx(known.sigma_a_error**2)
    raw.send("STAT:QUES:ENAB 2048;:FIT:ERR 1E-9,1E-9,1E-9,1E-9,1E-9;READ 0.04,0.02,0.006,0.001,0.00004;:FIT")
    assert raw.ask("*OPC?;:STAT:QUES:COND?;*STB?;*CLS;:STAT:QUES:COND?;EVEN?;*STB?") == "1;2048;24;2048;0;16"
    with shared.client() as client:
        R = client.eval("better", Medium(0.6624, 2.789), [1.0, 2.0]).R[0].tolist()
    for readings, error, bit in ((R, 0.05, 4096), ([0.02, 0.02], 0.01, 512), (R, 0, 1024)):  # ambiguous, at a bound, refused
        given = [",".join(map(repr, one)) for one in (readings, [error * one for one in readings])]
        raw.send("MED 0,1,0,1.3;:FIT:MOD better;PLAC 1,2;READ {};ERR {};:FIT".format(*given))
        assert raw.ask("*OPC?;:STAT:QUES:COND?") == f"1;{bit}"


def test_a_spectrum(shared, raw):
    """Readings of a known tissue give it back, with the bits that Python gets; without and with phases."""
    nm, at = [690.0, 760.0, 800.0, 850.0, 930.0, 970.0], [2.0, 4.0, 7.0, 12.0]
    truth = {"hbo2_uM": 56, "hb_uM": 24, "water_fraction": 0.6, "a_per_mm": 1.9, "b": 1.2}
    fat, listed = {"fat_fraction": 0.25}, lambda values: ",".join(map(repr, np.ravel(values).tolist()))
    raw.send("MED:TABL UCL;PROP fat,0.25;:FIT:SCAL FREE;SPEC:UNKN HBO2,HB,WAT,A,B;LIM HB,10,200;WAV " + listed(nm))
    assert raw.ask("FIT:SPEC:UNKN?") == ",".join(truth)
    with shared.client() as client:
        media = client.tissue(nm, properties=truth | fat, haemoglobin="ucl")
        made = client.eval("transport", media, at, wanted=["R", "phase", "modulation"], parameters={"mhz": 80}, evaluator="f64")
        sought = {**dict.fromkeys(truth), "hb_uM": (10, 200)}
        for more in ({"scale": "free"}, {"mhz": [0, 80, 80, 80], "quantity": [0, 0, 0, 262144]}):
            values = made.R.copy()
            if "mhz" in more:
                values[:, 1:3] *= made.modulation[:, 1:3]
                values[:, 3] = made.phase[:, 3]
                raw.send(f"FIT:SCAL DEF;SPEC:MHZ {listed(more['mhz'])};QUAN {listed(more['quantity'])}")
                more["quantity"] = ["R", "R", "R", "phase"]
            known = client.fit_tissue(sought, nm, at, values, 0.01 * values, properties=fat, haemoglobin="ucl", **more)
            raw.send(f"FIT:PLAC {listed(at)};READ {listed(values)};ERR {listed(0.01 * values)}")
            told = np.reshape(raw.numbers("FIT:SPEC;*WAI;EST?"), (len(truth), 4))
            for row, (name, one) in zip(told, known.estimates.items()):
                assert row.tolist() == [one["value"], one["error"], 1, one["numerical"]]
                assert row[0] == pytest.approx(truth[name], rel=0.01)
            names = ["saturation", "saturation_error", "total", "total_error", "chi_squared"]
            assert raw.numbers("FIT:SPEC:RES?")[:6] == [*(known.sets[name] for name in names), 1]
            assert raw.numbers("FIT:SPEC:COV?") == known.covariance.ravel().tolist()
    assert raw.error("FIT:SPEC:WAV 690;:FIT:SPEC").startswith('-226,"Lists not same length;FIT: ')
    told = raw.ask("FIT:SPEC:RES?")
    assert raw.ask(f"FIT:SPEC:WAV {listed(nm)};:FIT:AXIS F;SPEC;*WAI;:FIT:SPEC:RES?") != told
    assert raw.error("FIT:AXIS R;SPEC:LIM FAT,0,1").startswith('-221,"Settings conflict;FIT:SPECtrum:LIMit: ')
    assert raw.error("FIT:SPEC:UNKN CCO").startswith('-224,"Illegal parameter value;property: ')  # of two
    raw.send("FIT:SPEC:WAV 690,760,800,850,930,970;UNKN A,G;:FIT:SPEC;*WAI")
    assert raw.ask("SYST:ERR?").startswith('-222,"Data out of range;property: an amount, a_per_mm or b')


def test_waiting_for_monte_carlo(shared, raw):
    """*WAI, *OPC and *OPC? hold for all photons, and the rings are those of the binary protocol."""
    with shared.client() as client:
        known = client.mc(Stack(Medium(0.05, 9.5, 0.9, 1.4, 1), Medium(0.1, 9, 0.9, 1.4, 2)), Grid(0.0, 5.0, 6), photons=200_000, seed=3)
    raw.send(f"STAT:OPER:ENAB 16;:{MED},1;LAY2 0.1,9,0.9,1.4,2;:MC:PHOT 2E5;SEED 3;RINGs 0,5,5;STARt;*OPC")
    told = [[*map(float, one.split(","))] for one in raw.ask("*WAI;:MC:DATA?;ERR?;DATA? 2;ERR? 2;EDG?").split(";")]
    sides = [one[0, side].tolist() for side in (0, 1) for one in (known.values, known.errors)]
    assert told == [*sides, known.edges.tolist()]
    assert int(raw.ask("*ESR?")) & 1 and raw.ask("*STB?;:STAT:OPER:COND?;EVEN?;EVEN?;*STB?") == "128;0;16;0;16"
    assert raw.ask("*OPC?") == "1"
    assert raw.ask("MC:PHOT 1E4;STAR;*WAI;*ESR?") == "0"  # *OPC was for the job before


def test_a_job_runs_beside_queries_and_is_aborted(raw):
    raw.send(ENDLESS, "*OPC")
    assert raw.ask(f"*ESR?;:STAT:OPER:COND?;:{MED};:R? 1;:MC:PROG?").startswith("128;16;0.0161")
    assert raw.error("MC:STAR").startswith('-221,"Settings conflict;MC:STARt')
    assert raw.ask("MC:ABOR;*OPC?;PROG?").endswith(",3")
    assert int(raw.ask("*ESR?")) & 1
    assert len(raw.numbers("MC:DATA?")) == 5
    for forgets, ends in (("*CLS", "MC:ABOR"), ("*RST", "")):  # that *OPC was sent
        raw.send(ENDLESS, "*OPC", forgets, ends, "*WAI", "*ESR?")
        assert raw.line() == "0" and raw.ask(f"{MED};:MC:PHOT 8192;STAR;*OPC?;*ESR?;:STAT:OPER:COND?") == "1;0;0"


def test_jobs_end_with_their_client(shared):
    with shared.client() as client:
        open_jobs = lambda: client.statistics()["mc_jobs_open"]
        for hold in ("*IDN?", "*OPC?"):
            with Raw(shared) as raw:
                raw.send(ENDLESS, hold)
                assert eventually(lambda: open_jobs() == 1)
            assert eventually(lambda: open_jobs() == 0)


def test_a_client_that_closes_its_side_gets_its_answers(shared):
    with Raw(shared) as raw:
        raw.send(f"{MED};:R? 1", "*IDN?", "*OPC?")
        raw.socket.shutdown(socket.SHUT_WR)
        assert len(raw.file.read().splitlines()) == 3


def test_a_drain_answers_what_was_read(shared):
    one = Daemon(*SCPI)
    with Raw(one) as waits, Raw(one) as rests:
        waits.send(ENDLESS)
        assert waits.ask("*IDN?") and rests.ask("*IDN?")
        waits.send("*OPC?;:MC:PROG?")
        one.terminate()
        assert waits.line().endswith(",4") and waits.line() == ""
        assert rests.line() == ""
    one.close()


# ---- streams -------------------------------------------------------------------------------------


def test_messages_in_one_segment_and_in_pieces(raw):
    raw.send("*IDN?", MED, "R? 1", "MED?")
    assert [raw.line()[:7] for _ in range(3)] == ["dipoled", "0.01616", "0.05,9."]
    block = struct.pack(">2d", *np.frombuffer(b"\n;\n;\n;\n?" b"@\n\n\n\n\n\n\n", ">f8"))
    for byte in b"FORM REAL,64;:R:DATA #216" + block + b";:FORM ASC;*IDN?\n":
        raw.socket.sendall(bytes([byte]))
    assert raw.line().startswith("dipoled") and raw.ask("SYST:ERR?") == NO_ERROR
    assert len(raw.numbers("R:DATA?")) == 2


def test_the_end_of_the_stream_ends_a_message(shared):
    """But not within a block, of which the rest is missing."""
    for last, answers in (("*IDN?;*TST?", 1), ("R:DATA #15ab", 0), ("*IDN?\r", 1), ("*TST?\n", 1)):
        with Raw(shared) as raw:
            raw.socket.sendall(f"*TST?\n{last}".encode())
            raw.socket.shutdown(socket.SHUT_WR)
            assert len(raw.file.read().splitlines()) == 1 + answers, last


def test_a_flood_and_its_answers_in_order(raw):
    count = 20_000
    sender = threading.Thread(target=lambda: raw.send(*(f"*ESE {i % 256};*ESE?" for i in range(count))))
    sender.start()
    assert [int(raw.line()) for _ in range(count)] == [i % 256 for i in range(count)]
    sender.join()


def test_garbage_has_one_error_a_line(raw):
    raw.socket.sendall(b"\x16\x03\x01\0\xff\n\n\n;;;\n GET / HTTP/1.1\r\n#9999999999x\n* \n")
    assert raw.ask("*CLS;*IDN?;:SYST:ERR:COUN?").endswith(";0")
    errors = [raw.error("".join(map(chr, range(33, 127)))), raw.error("R? #H1F"), raw.error(":")]
    assert [one.partition(",")[0] for one in errors] == ["-101", "-104", "-101"]


def test_a_full_queue_of_errors(raw):
    raw.send("*RST;*CLS", *(f"BAD{i}" for i in range(20)))
    assert raw.ask("SYST:ERR:COUN?") == "16"
    errors = [raw.ask("SYST:ERR?") for _ in range(17)]
    assert errors[0] == '-113,"Undefined header;BAD0"' and errors[14].endswith('BAD14"')
    assert errors[15:] == ['-350,"Queue overflow"', NO_ERROR]
    raw.send("*SRE 36;*ESE 32;:BAD")
    assert raw.ask("*STB?;*ESR?;*STB?;*CLS;*STB?") == "100;40;84;16"  # -350 is an error of the device
    raw.send("MED 1,2,2,1")
    assert raw.ask("*ESR?") == "16"


def drops_an_incomplete_message(raw: Raw) -> bool:
    """Returns False if its newline came too early."""
    raw.socket.sendall(b"*CLS;*IDN?;BAD")
    select.select([raw.socket], [], [], 0.5)
    answer = raw.ask("\nSYST:ERR?")
    return answer.startswith("-365") or not raw.line()


def test_limits():
    """A message that is too long is dropped up to its newline, one that stays incomplete is dropped,
    and a silent client is closed; one connection more is closed at once."""
    one = Daemon(*SCPI, "--max-part-bytes", "4096", "--frame-timeout-ms", "100", "--max-scpi-connections", "3")
    with Raw(one) as raw:
        assert raw.error("R? " + "1," * 100_000 + "1").startswith('-363,"Input buffer overrun')
        assert raw.error("R:DATA #510000" + 2 * "\n" + 9998 * "x").startswith("-363")
        assert raw.error(f"{MED};:R:DATA {','.join(['1'] * 2000)};DATA?").startswith('-223,"Too much data')
        assert raw.ask("*TST?".ljust(4095)) == "0" and raw.error("*TST?".ljust(4096)).startswith("-363")
        assert eventually(lambda: drops_an_incomplete_message(raw))
        with Raw(one) as second, Raw(one) as third, Raw(one) as fourth:
            assert second.ask("*TST?") == third.ask("*TST?") == "0"
            assert fourth.line() == ""
            with one.client() as client:
                told = lambda: [client.statistics()[f"scpi_{what}"] for what in (
                    "connections_open", "connections_accepted", "connections_refused", "messages")]
                *connections, messages = told()
                assert third.ask("*TST?") == "0" and told() == [3, 3, 1, messages + 1] == [*connections, messages + 1]
    assert one.has_line("event=scpi-refused reason=max-scpi-connections")
    one.close()
    one = Daemon(*SCPI, "--idle-timeout-ms", "200", "--scpi-allow", "127.0.0.0/8")
    with Raw(one) as raw:
        assert raw.ask(f"{MED};:MC:PHOT 2E5;STAR;*OPC?") == "1" and raw.line() == ""  # which works for longer
    one.close()


def test_who_is_not_allowed():
    """And fills no log: a line of a later second counts those that were left out."""
    one = Daemon(*SCPI, "--scpi-allow", "10.0.0.0/8")
    for i in range(202):
        time.sleep(1 - time.time() % 1 if i == 200 else 0)
        with Raw(one) as raw:
            assert raw.line() == ""
    told = lambda: [read_log_line(line) for line in one.log if re.match(
        r"ts=\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z level=info event=scpi-refused reason=not-allowed", line)]
    assert eventually(lambda: sum(1 + int(line.get("suppressed", 0)) for line in told()) == 202), one.log
    one.close()


def test_a_client_that_does_not_read(shared):
    """It costs bounded memory, others go on, and its answers come when it reads."""
    with Raw(shared) as slow, Raw(shared) as other:
        before = shared.resident_bytes()
        count, places = 3000, ",".join(["0.125"] * 500)
        slow.send(f"FIT:PLAC {places}")
        sent = threading.Thread(target=lambda: slow.send(*["FIT:PLAC?"] * count))
        sent.start()
        for _ in range(20):
            assert other.ask(f"{MED};:R? 1").startswith("0.0161")
        assert shared.resident_bytes() - before < 8e6
        assert {slow.line() for _ in range(count)} == {places}
        sent.join()


def test_a_thousand_clients(shared):
    """Each has its own medium, and the right answer."""
    clients = [Raw(shared) for _ in range(1000)]
    try:
        for i, one in enumerate(clients):
            one.send(f"*IDN?;:MED {0.01 + i * 1e-4!r},9.5,0.9,1.4;:MOD better;:EVAL F64;*OPC?")
        for i, one in enumerate(clients):
            assert one.line().endswith(";1")
            one.send("R? 1")
        radii = [float(one.line()) for one in clients]
        assert radii == sorted(radii, reverse=True) and len(set(radii)) == 1000
    finally:
        for one in clients:
            one.__exit__()
