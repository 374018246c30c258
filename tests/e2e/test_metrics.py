"""--metrics: the text format of Prometheus over HTTP, and /healthz."""

import ctypes
import http.client
import itertools
import json
import math
import os
import re
import shutil
import socket
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

import dipole
import pytest
from daemons import BUILD, REPOSITORY, eventually, finished, read_log_line, run
from frames import EVAL, SKIN, R, ask, assert_serves, eval_payload
from lists import MODELS
from modbus_master import AT, Tcp, exception
from test_scpi import ENDLESS, SCPI, Raw

TIMEOUT_S = 10


def address_of(daemon) -> str:
    """Returns the HOST:PORT of the metrics, which the daemon has logged."""
    lines = map(read_log_line, daemon.log)
    url = next(line["url"] for line in lines if line.get("event") == "metrics")
    return re.fullmatch(r"http://(.+:\d+)/metrics", url)[1]


@pytest.fixture
def watched(daemon):
    """Returns a daemon that serves metrics at a free port."""
    return daemon("--metrics", "127.0.0.1:0")


def fetch(daemon, path: str, method: str = "GET", body: bytes | None = None):
    """Makes an HTTP request. Returns the status, headers and body."""
    request = urllib.request.Request(f"http://{address_of(daemon)}{path}", body, method=method)
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
            return answer.status, answer.headers, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.headers, error.read().decode()


NAME = r"[a-zA-Z_:][a-zA-Z0-9_:]*"
LABEL = r'[a-zA-Z_][a-zA-Z0-9_]*="[^"\\\n]*"'
SAMPLE = re.compile(rf"({NAME})(?:\{{({LABEL}(?:,{LABEL})*)\}})? ([0-9.]+(?:e[+-]?\d+)?)")
SUFFIXES = {"histogram": ["_bucket", "_sum", "_count"]}


def parse(text: str) -> dict[str, tuple[str, dict[str, float]]]:
    """Parses metrics. Returns the type of each family, and its samples by name and labels. Checks
    the order of lines: HELP, TYPE, and then only the family's samples, none of them twice."""
    families: dict[str, tuple[str, dict[str, float]]] = {}
    lines = text.split("\n")
    assert lines.pop() == ""
    helped = current = None
    for line in lines:
        if helped_now := re.fullmatch(rf"# HELP ({NAME}) (\S.*)", line):
            assert helped is None, line
            helped = helped_now[1]
        elif line.startswith("#"):
            _, name, type = re.fullmatch(
                rf"# (TYPE) ({NAME}) (counter|gauge|histogram)", line
            ).groups()
            assert name == helped and name not in families
            assert name.endswith("_total") == (type == "counter")
            families[name] = (type, {})
            helped, current = None, name
        else:
            name, labels, value = SAMPLE.fullmatch(line).groups()
            type, samples = families[current]
            assert helped is None
            assert name in [current + suffix for suffix in SUFFIXES.get(type, [""])]
            key = f"{name}{{{labels}}}" if labels else name
            assert key not in samples
            samples[key] = float(value)
            assert math.isfinite(samples[key])
    assert all(samples for _, samples in families.values())
    return families


def scrape(daemon) -> dict[str, float]:
    """Fetches and parses the metrics. Returns all samples."""
    status, headers, text = fetch(daemon, "/metrics")
    assert status == 200
    assert headers["Content-Type"] == "text/plain; version=0.0.4; charset=utf-8"
    families = parse(text)
    return {key: value for _, samples in families.values() for key, value in samples.items()}


def scrape_when(daemon, metric: str, least: float) -> dict[str, float]:
    """Fetches the metrics until one has this value. Latencies are counted only after the
    answers."""
    assert eventually(lambda: scrape(daemon)[metric] >= least)
    return scrape(daemon)


def test_every_line_is_right(watched):
    with watched.connect() as connection:
        ask(connection, EVAL, eval_payload([SKIN], [1.0] * 16, wanted=R))
    families = parse(fetch(watched, "/metrics")[2])
    assert families["dipoled_requests_total"][0] == "counter"
    assert families["dipoled_connections_open"][0] == "gauge"
    type, latencies = families["dipoled_latency_seconds"]
    assert type == "histogram"
    for kind in ("eval_short", "eval_long", "other", "refused"):
        buckets = [value for key, value in latencies.items() if f'_bucket{{class="{kind}"' in key]
        assert len(buckets) == 26 and buckets == sorted(buckets)
        assert buckets[-1] == latencies[f'dipoled_latency_seconds_count{{class="{kind}"}}']
    assert families["dipoled_batches_evaluated_total"][1] == {"dipoled_batches_evaluated_total": 1}
    models = families["dipoled_model_radii_total"][1]
    assert set(models) == {f'dipoled_model_radii_total{{model="{name}"}}' for name in MODELS}


def test_counters_rise(watched):
    before = scrape(watched)
    with watched.connect() as connection:
        for _ in range(5):
            ask(connection, EVAL, eval_payload([SKIN], [1.0] * 16))
        for _ in range(3):
            ask(connection, EVAL, eval_payload(model=99))
        after = scrape_when(watched, 'dipoled_latency_seconds_count{class="refused"}', 3)
    rises = {key: value - before[key] for key, value in after.items() if value != before[key]}
    assert rises['dipoled_requests_total{message="eval"}'] == 8
    assert rises['dipoled_replies_total{status="ok"}'] == 5
    assert rises['dipoled_replies_total{status="bad-value"}'] == 3
    assert rises['dipoled_model_radii_total{model="better"}'] == 80
    assert rises["dipoled_radii_evaluated_total"] == 80
    assert rises['dipoled_latency_seconds_count{class="eval_short"}'] == 5
    assert rises['dipoled_latency_seconds_count{class="refused"}'] == 3
    assert rises["dipoled_connections_open"] == 1
    below = [
        (float(re.search('le="(.*)"', key)[1]), rises.get(key, 0))
        for key in after
        if key.startswith('dipoled_latency_seconds_bucket{class="eval_short"')
    ]
    assert below[0][0] == 4.096e-6 and below[-1] == (math.inf, 5)
    assert dict(below)[1.073741824] == 5
    sum_s = rises['dipoled_latency_seconds_sum{class="eval_short"}']
    assert 0 < sum_s < 5 * next(le for le, count in below if count == 5)
    assert all(later >= 0 for key, later in rises.items() if "_total" in key or "_count" in key)


def test_the_same_as_the_statistics(watched):
    with watched.client() as client, watched.connect() as connection:
        ask(connection, EVAL, eval_payload([SKIN], [1.0] * 1000))
        client.ping()
        scrape_when(watched, 'dipoled_latency_seconds_count{class="eval_long"}', 1)
        metrics = scrape(watched)
        statistics = client.statistics()
    moving = {"uptime_ms", "received_bytes", "sent_bytes", "queued_connections"}
    for name in set(statistics) - moving:
        for suffix in ("", "_total"):
            if f"dipoled_{name}{suffix}" in metrics:
                assert metrics[f"dipoled_{name}{suffix}"] == statistics[name]
    by_name = {
        "requests_ping": 'requests_total{message="ping"}',
        "radii_better": 'model_radii_total{model="better"}',
        "latency_eval_long_count": 'latency_seconds_count{class="eval_long"}',
    }
    for name, metric in by_name.items():
        assert statistics[name] == metrics[f"dipoled_{metric}"] > 0
    longest_s = metrics['dipoled_latency_seconds_sum{class="eval_long"}']
    assert abs(longest_s * 1e6 - statistics["latency_eval_long_max_us"]) <= 0.51


def test_health(watched):
    for path in ("/healthz", "/readyz"):
        status, headers, text = fetch(watched, path)
        assert (status, text) == (200, "ok\n")
        assert headers["Content-Type"].startswith("text/plain")


def health(port: int, path: str) -> tuple[int, str]:
    """Returns the status of HTTP and the name of the daemon's state, of text or JSON."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=TIMEOUT_S)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        text = answer.read().decode()
        is_json = answer.headers["Content-Type"] == "application/json"
        return answer.status, json.loads(text)["status"] if is_json else re.match(r"\w+", text)[0]
    finally:
        connection.close()


def health_ports(daemon) -> list[int]:
    """Returns the ports of --metrics and --http."""
    return [int(re.search(r"url=http://.*?:(\d+)", x)[1]) for x in daemon.log if "url=http:" in x]


def test_overload_makes_the_daemon_unready_for_a_second(daemon):
    one = daemon("--metrics", "127.0.0.1:0", "--http", "127.0.0.1:0", "--max-connections", "1")
    ports = health_ports(one)
    assert len(ports) == 2

    def is_unready(port: int) -> bool:
        with one.connect() as refused:
            refused.receive_frame()  # BUSY
        return health(port, "/readyz") == (503, "overloaded")

    with one.connect():
        for port in ports:  # A machine under load may take longer than that second to ask.
            assert eventually(lambda: is_unready(port))
            assert health(port, "/healthz") == (200, "ok")
        for port in ports:
            assert eventually(lambda: health(port, "/readyz") == (200, "ok"))


@pytest.mark.parametrize("way", ["binary", "modbus", "scpi"])
def test_a_busy_reply_counts_whatever_way_it_takes(daemon, way):
    one = daemon("--metrics", "127.0.0.1:0", "--modbus", "tcp:127.0.0.1:0", *SCPI, "--max-mc-jobs", "1")
    asked = []
    with dipole.Client(one.url(), retry_s=0) as client, Raw(one) as first, Raw(one) as scpi, Tcp(one) as master:
        first.send(ENDLESS)
        assert eventually(lambda: client.statistics()["mc_jobs_open"] == 1)

        def is_unready() -> bool:
            asked.append(way)
            if way == "binary":
                with pytest.raises(dipole.Refused, match="busy"):
                    client.mc(dipole.Medium(0.1, 1), dipole.Grid(0, 5, 6), photons=100)
            elif way == "scpi":
                assert "max_mc_jobs" in scpi.error("MED 0.1,1,0,1.3;:MC:PHOT 100;RINGs 0,5,5;STARt;*WAI")
            else:
                with exception(6):
                    master.write_one(AT["MC_COMMIT"], 7)
            return health(health_ports(one)[0], "/readyz") == (503, "overloaded")

        assert eventually(is_unready)
        after = client.statistics()
        assert after["modbus_exceptions" if way == "modbus" else "replies_busy"] == len(asked)
        assert after["latency_refused_count"] == len(asked)


PTRACE_ATTACH, PTRACE_DETACH, WAIT_ALL = 16, 17, 0x40000000


def trace(request: int, threads: list[int]) -> None:
    """Stops single threads of a child, or lets them go on (ptrace(2))."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    for thread in threads:
        if libc.ptrace(request, thread, None, None) != 0:
            pytest.skip(f"ptrace: {os.strerror(ctypes.get_errno())}")
        if request == PTRACE_ATTACH:
            os.waitpid(thread, WAIT_ALL)


def test_healthz_when_no_worker_finishes_a_turn(daemon):
    one = daemon("--metrics", "127.0.0.1:0", "--workers", "2")
    folder = Path(f"/proc/{one.process.pid}/task")

    def named_workers() -> list[int]:  # A thread names itself when it starts to run.
        return [
            int(thread.name)
            for thread in folder.iterdir()
            if (thread / "comm").read_text() == "worker\n"
        ]

    assert eventually(lambda: len(named_workers()) == 2)
    workers = named_workers()
    trace(PTRACE_ATTACH, workers[:1])
    try:  # The other worker goes round.
        assert not eventually(lambda: fetch(one, "/healthz")[0] != 200, 3.5, 0.1)
        trace(PTRACE_ATTACH, workers[1:])
        assert eventually(lambda: fetch(one, "/healthz")[0] == 503)
        assert fetch(one, "/healthz")[2].startswith("stalled: ")
        assert fetch(one, "/readyz")[0] == 503 and fetch(one, "/readyz")[2].startswith("stalled: ")
        assert scrape(one)["dipoled_workers_silent_seconds"] >= 3
    finally:
        trace(PTRACE_DETACH, workers)
    assert eventually(lambda: fetch(one, "/healthz")[0] == 200)
    assert eventually(lambda: scrape(one)["dipoled_workers_silent_seconds"] < 3)


WRONG_PATHS = ["/", "/metric", "/metrics/", "/metrics/x", "/healthz%00", "/readyz/", "/Metrics"]


def test_wrong_paths(watched):
    for path in WRONG_PATHS:
        assert fetch(watched, path)[0] == fetch(watched, path, "POST", b"x" * 100)[0] == 404, path


def test_wrong_methods(watched):
    for method, path in itertools.product(["POST", "PUT", "DELETE", "OPTIONS", "PATCH"], ["/metrics", "/healthz", "/readyz"]):
        status, headers, _ = fetch(watched, path, method, b"x" if method == "POST" else None)
        assert (status, headers["Allow"]) == (405, "GET, HEAD"), (method, path)
    assert fetch(watched, "/healthz")[0] == 200


def test_head_has_no_body(watched):
    status, headers, text = fetch(watched, "/metrics", "HEAD")
    assert (status, text) == (200, "")
    assert int(headers["Content-Length"]) > 1000


def raw(daemon) -> socket.socket:
    """Opens a bare TCP connection."""
    host, _, port = address_of(daemon).rpartition(":")
    return socket.create_connection((host, int(port)), TIMEOUT_S)


def test_stop_while_scrapes_hang(watched):
    hanging = [raw(watched) for _ in range(10)]
    for i, one in enumerate(hanging):
        one.sendall([b"", b"GET /met", b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n", b"P"][i % 4])
    assert fetch(watched, "/healthz")[0] == 200
    watched.terminate()
    assert watched.wait() == 0
    for one in hanging:
        one.close()


def test_connections_are_not_clients(watched):
    scrape(watched)
    assert scrape(watched)["dipoled_connections_accepted_total"] == 0


def test_loopback_without_a_host(daemon):
    for value in ("0", ":0"):
        assert address_of(daemon("--metrics", value)).startswith("127.0.0.1:")


def test_ipv6(daemon):
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("no IPv6 here")
    one = daemon("--metrics", "[::1]:0")
    assert address_of(one).startswith("[::1]:")
    assert fetch(one, "/healthz")[2] == "ok\n"


def test_not_unless_asked_for(shared):
    assert not any("event=metrics" in line for line in shared.log)


def test_an_address_that_is_taken(watched):
    taken = address_of(watched)
    ended = run("--listen", "tcp:127.0.0.1:0", "--metrics", taken)
    assert ended.returncode == 1 and "--metrics" in ended.stderr and "Address already in use" in ended.stderr


# ---- Prometheus itself ---------------------------------------------------------------------------


def program(name: str) -> str:
    """Returns the path of one of Debian's programs of Prometheus."""
    found = shutil.which(name) or str(BUILD / name)
    if not Path(found).exists():
        pytest.skip(f"there is no {name}, neither installed nor in the build folder")
    return found


def promtool(*arguments: str, stdin: str = "") -> str:
    """Runs promtool, which checks metrics and rules. Returns what it says."""
    run = finished(program("promtool"), *arguments, input=stdin)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout + run.stderr


def test_promtool_has_nothing_to_say(watched):
    with watched.connect() as connection:
        ask(connection, EVAL, eval_payload([SKIN], [1.0] * 16))
    assert promtool("check", "metrics", stdin=fetch(watched, "/metrics")[2]) == ""


def test_the_process(watched):
    before = time.time()
    metrics = scrape(watched)
    assert before - 60 < metrics["process_start_time_seconds"] < before
    assert scrape(watched)["process_start_time_seconds"] == metrics["process_start_time_seconds"]
    resident = metrics["process_resident_memory_bytes"]
    assert resident == pytest.approx(watched.resident_bytes(), rel=0.5)
    assert resident < metrics["process_virtual_memory_bytes"]
    assert 3 < metrics["process_open_fds"] < metrics["process_max_fds"]
    assert metrics["process_cpu_seconds_total"] > 0
    with watched.client() as client:
        version = client.info.software.split()[1]
        labels = f'version="{version}",instruction_set="{client.info.instruction_set}"'
    assert metrics[f"dipoled_build_info{{{labels}}}"] == 1


def test_scrapes_leave_nothing_behind(watched):
    """Neither descriptors nor memory: one scrape's text has some 20 kB."""

    def held(scrapes: int) -> tuple[int, int]:
        for _ in range(scrapes):
            fetch(watched, "/metrics")
        return len(os.listdir(f"/proc/{watched.process.pid}/fd")), watched.resident_bytes()

    descriptors, resident = held(100)
    more_descriptors, more_resident = held(400)
    assert more_descriptors < descriptors + 50 and more_resident < resident + 2_000_000
    with raw(watched) as one:  # nor do they count among the connections that there may be
        one.sendall(b"GET /healthz HTTP/1.1\r\n")
        held(1)
        one.sendall(b"Host: localhost\r\n\r\n")
        assert one.recv(100).startswith(b"HTTP/1.1 200 ")


def test_examples_of_alerts(watched):
    path = REPOSITORY / "clients/deploy/alerts.yml"
    assert "SUCCESS: 8 rules found" in promtool("check", "rules", str(path))
    expressions = re.findall(r"(?:dipoled|process)_\w+", path.read_text())
    names = {re.sub(r"\{.*", "", key) for key in scrape(watched)}
    assert set(expressions) <= names


def test_example_of_a_dashboard(watched, tmp_path):
    """Its expressions are such, and ask for what there is."""
    dashboard = json.loads((REPOSITORY / "clients/deploy/dashboard.json").read_text())
    names = {re.sub(r"\{.*", "", key) for key in scrape(watched)}
    for panel in dashboard["panels"]:
        for target in panel["targets"]:
            used = re.findall(r"(?:dipoled|process)_\w+", target["expr"])
            assert used and set(used) <= names, target["expr"]
    asked = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    asked = [one.replace("$__rate_interval", "5s") for one in asked]
    rules = [{"record": f"n{i}", "expr": one} for i, one in enumerate(asked)]
    (tmp_path / "rules.yml").write_text(json.dumps({"groups": [{"name": "dashboard", "rules": rules}]}))
    assert f"{len(rules)} rules found" in promtool("check", "rules", str(tmp_path / "rules.yml"))


# ---- the log -------------------------------------------------------------------------------------


def ends(daemon, status: str) -> dict[str, str]:
    """Waits for the log line of a connection's end with this status."""
    assert daemon.has_line(f" status={status}", TIMEOUT_S)
    return next(read_log_line(line) for line in daemon.log if f" status={status}" in line)


@pytest.mark.parametrize("scheme", ["tcp", "unix", "IPv4 at an address of IPv6"])
def test_refusals_and_endings_name_the_peer(daemon, scheme):
    mapped = {"listen": ["tcp:[::]:0"]} if "IPv6" in scheme else {}
    one = daemon("--max-connections", "1", **mapped)
    url = one.url("tcp").replace("[::]", "127.0.0.1") if mapped else one.url(scheme)
    with dipole.Connection(url) as first:
        assert_serves(first)
        with dipole.Connection(url) as second:
            second.receive_frame()
        refused = ends(one, "busy")
        first.send_bytes(b"nonsense" * 4)
        ended = ends(one, "bad-magic")
    assert refused["event"] == "connection-refused" and refused["field"] == "max_connections"
    assert ended["event"] == "connection-ended"
    peer = r"127\.0\.0\.1:\d+" if scheme != "unix" else rf"unix:pid={os.getpid()},uid={os.getuid()}"
    assert re.fullmatch(peer, refused["peer"]) and re.fullmatch(peer, ended["peer"])
