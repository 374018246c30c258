"""Runs each target of tests/fuzz/fuzz.h with libFuzzer, on all processors, and prints the outcome
of each.

  fuzz.py PROGRAM check SECONDS  runs the corpus and CHECK_RUNS more inputs of each target from a
                                 fixed seed, or fewer if that would take longer than SECONDS
  fuzz.py PROGRAM SECONDS        runs for SECONDS in all, and goes on from what earlier runs found
  fuzz.py PROGRAM merge          adds the found inputs that reach new code to the corpus

The corpus is tests/fuzz/corpus: a target and an input in base64 on each line. The hexadecimal
examples of PROTOCOL.md and REGISTERS.md are inputs as well. All inputs are unpacked into folders
beside the program, and new ones are kept there."""

import base64
import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

FUZZ = Path(__file__).parent
CORPUS = FUZZ / "corpus"
PROTO = FUZZ.parent.parent / "proto"
CHECK_RUNS = 20000
MEMORY_MB = 3000
JOBS = int(os.environ.get("FUZZ_JOBS", os.cpu_count() or 1))


def targets() -> list[str]:
    """Returns the names of the program's targets."""
    environment = os.environ | {"FUZZ_TARGET": ""}
    return subprocess.run([sys.argv[1]], env=environment, capture_output=True, text=True).stdout.split()


# ---- inputs --------------------------------------------------------------------------------------


def examples(path: str) -> dict[str, bytes]:
    """Reads the blocks ```hex NAME of a document: pairs of digits, and comments from # to the end
    of the line."""
    blocks = re.findall(r"^```hex ([\w-]+)\n(.*?)^```", (PROTO / path).read_text(), re.M | re.S)
    return {name: bytes.fromhex(re.sub(r"#.*", "", body)) for name, body in blocks}


def seeds() -> Iterator[tuple[str, bytes]]:
    """Yields the examples in the documents as inputs of the targets that can use them."""
    frames = examples("PROTOCOL.md")
    asked = b"".join(data for name, data in frames.items() if name.endswith("-request"))
    for data in [*frames.values(), asked]:
        yield from [("frames", b"\x07" + data), ("requests", b"\x00" + data)]
        yield from [("connection", b"\x00\x00" + data), ("messages", data[6:8] + data[24:])]
        yield "replies", data[6:7] + b"\x00" + data
    for data in examples("REGISTERS.md").values():
        yield "modbus", b"\x00\x00" + data
        yield "rtu", bytes([5, len(data) - 6]) + data[6:]  # with a checksum, and before a silence


def kept(lines: list[str]) -> Iterator[tuple[str, bytes]]:
    """Yields the inputs in lines of the corpus. A stream of requests is one of a connection, too."""
    for line in lines:
        name, text = line.split()
        data = base64.b64decode(text)
        yield name, data
        if name == "requests":
            yield "connection", data[:1] + b"\x00" + data[1:]


def unpack(inputs: Iterable[tuple[str, bytes]], folder: Path) -> None:
    for name in targets():
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, data in inputs:
        (folder / name / hashlib.sha1(data).hexdigest()).write_bytes(data)


# ---- running -------------------------------------------------------------------------------------


def libfuzzer(program: Path, name: str, log: Path, *arguments: str) -> int:
    """Runs one target. Returns its exit status."""
    # The program looks for hangs itself, since libFuzzer's clock runs while others have the processors.
    flags = ["-timeout=0", f"-rss_limit_mb={MEMORY_MB}", f"-artifact_prefix={log.parent}/{name}-"]
    environment = os.environ | {"FUZZ_TARGET": name}
    with log.open("wb") as output:
        command = [str(program), *flags, "-print_final_stats=1", *arguments]
        return subprocess.run(command, stdout=output, stderr=output, env=environment).returncode


def report(name: str, status: int, log: Path, took_s: float) -> bool:
    """Prints the outcome of a run. Returns whether it found no fault."""
    text = log.read_text(errors="replace")
    executions = re.findall(r"stat::number_of_executed_units: (\d+)", text)
    edges = re.findall(r" cov: (\d+) ", text)
    inputs = re.findall(r" corp: (\d+)/", text)
    shown = [(found or ["?"])[-1] for found in (executions, edges, inputs)]
    good = status == 0
    print(f"fuzz: {name:10} {shown[0]:>10} executions {shown[1]:>6} edges {shown[2]:>5} inputs"
          f" {took_s:6.0f} s{'' if good else '  FAILED'}", flush=True)
    if not good:
        told = [line for line in text.splitlines() if not line.startswith("#")]
        print("\n".join(told[-60:]))
        for written in re.findall(r"Test unit written to (\S+)", text):
            print(f"fuzz: {name}: reproduce: FUZZ_TARGET={name} {sys.argv[1]} {written}", flush=True)
    return good


def run_all(program: Path, folder: Path, arguments: list[str]) -> bool:
    def run_one(name: str) -> bool:
        log = folder / f"{name}.log"
        began = time.monotonic()
        status = libfuzzer(program, name, log, *arguments, str(folder / "corpus" / name))
        return report(name, status, log, time.monotonic() - began)

    with ThreadPoolExecutor(JOBS) as pool:
        return all(list(pool.map(run_one, targets())))


def merge(program: Path, folder: Path) -> None:
    """Rewrites the corpus with the fewest inputs of each target that reach all edges that are
    reached now."""
    lines: list[str] = []
    for name in targets():
        shutil.rmtree(folder / "merged", ignore_errors=True)
        unpack([*seeds(), *kept(lines)], folder / "merged")
        merged = folder / "merged" / name
        free = set(merged.iterdir())
        log = folder / f"{name}-merge.log"
        source = str(folder / "corpus" / name)
        if libfuzzer(program, name, log, "-merge=1", "-use_counters=0", str(merged), source) != 0:
            sys.exit(f"fuzz: {name}: merging failed: {log}")
        inputs = sorted(path.read_bytes() for path in set(merged.iterdir()) - free)
        lines += [f"{name} {base64.b64encode(data).decode()}\n" for data in inputs]
        print(f"fuzz: {name:10} {len(inputs):5} inputs {sum(map(len, inputs)):8} bytes")
    CORPUS.write_text("".join(lines))


def main() -> None:
    program, what = Path(sys.argv[1]).absolute(), sys.argv[2]
    folder = program.parent / "fuzzing"
    unpack([*seeds(), *kept(CORPUS.read_text().splitlines())], folder / "corpus")
    if what == "merge":
        merge(program, folder)
        return
    if what == "check":
        arguments = ["-seed=1", f"-runs={CHECK_RUNS}", f"-max_total_time={sys.argv[3]}"]
    else:
        arguments = [f"-max_total_time={max(1, int(what) * JOBS // len(targets()))}"]
    if not run_all(program, folder, arguments):
        sys.exit(1)


main()
