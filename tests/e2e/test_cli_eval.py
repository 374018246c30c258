"""`dipole eval`: which daemon it asks, and connections that are lost."""

from command_line import Proxy, dipole, eval_json
from daemons import read_log_line

MEDIUM = ["--sigma-a", "0.01,0.1", "--sigma-s", "10", "--g", "0.9", "--eta", "1.4"]


# ---- daemons -------------------------------------------------------------------------------------


def test_the_daemon_is_named_by_option_or_environment(daemon):
    one = daemon()
    by_option = eval_json(*MEDIUM, "--count", "2", "--connect", one.url("tcp"))
    by_variable = dipole(
        *["eval", *MEDIUM, "--count", "2", "--format", "json"], env={"DIPOLED": one.url("unix")}
    )
    with one.client() as client:
        assert client.statistics()["requests_eval"] == 2
    assert by_variable.stdout == dipole("eval", *MEDIUM, "--count", "2", "--format", "json").stdout
    assert by_option == eval_json(*MEDIUM, "--count", "2")


def test_a_private_daemon_serves_nobody_else(daemon, tmp_path):
    """Nor is it disturbed by an environment that makes another daemon serve others."""
    one = daemon("--modbus", "tcp:127.0.0.1:0", "--metrics", "127.0.0.1:0")
    line = next(line for line in map(read_log_line, one.log) if line.get("event") == "metrics")
    taken = line["url"].removeprefix("http://").split("/")[0]
    env = {"DIPOLED": "private:", "DIPOLED_LISTEN": f"unix:{tmp_path}/s", "DIPOLED_METRICS": taken, "DIPOLED_HTTP": taken}
    dipole("media", env={**env, "DIPOLED_SCPI": taken, "DIPOLED_MODBUS": one.url("modbus-tcp").removeprefix("modbus-")})
    assert not (tmp_path / "s").exists()


def test_a_connection_that_is_lost(daemon):
    with Proxy(daemon().url(), lambda number, request_id: False) as proxy:
        run = dipole("eval", *MEDIUM, "--connect", proxy.url, "--retry-ms", "300", status=1)
    assert run.stdout == ""
    said = f"the daemon, or a proxy, closed the connection at {proxy.url} without a reason"
    assert said in run.stderr
