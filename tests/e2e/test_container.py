"""The container image: its files are enough for the daemon, as nobody and without a shell, and
podman builds it."""

import json
import os
import re
import shutil
import signal
import subprocess
from pathlib import Path

import dipole
import pytest
import yaml
from daemons import BUILD, END_S, PROGRAM, REPOSITORY, eventually, sanitized
from frames import SKIN
from installing import make, needs, npm_install, run
from test_balancer import free_port
from test_metrics import fetch, scrape

NOBODY = 65534
CONTAINERFILE = (REPOSITORY / "clients/deploy/Containerfile").read_text()

MANIFESTS = list(yaml.safe_load_all((REPOSITORY / "clients/deploy/kubernetes.yml").read_text()))
# The packages that npm fetches, if npm is installed: versions that are known to work. The first is
# made from the published schema of Kubernetes.
NODE_MODULES = {"kubernetes-models": "4.4.2", "typescript": "5.4.5"}

pytestmark = pytest.mark.skipif(sanitized(), reason="the build is sanitized")


def settings(word: str) -> list[str]:
    """Returns the instructions of the Containerfile that begin with this word."""
    lines = CONTAINERFILE.replace("\\\n", " ").splitlines()
    return [line.removeprefix(word).strip() for line in lines if line.startswith(word + " ")]


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    """Returns the image's file system."""
    folder = tmp_path_factory.mktemp("container") / "image"
    run("sh", "clients/packaging/container.sh", BUILD, folder)
    return folder / "root"


def test_there_is_nothing_but_programs_and_libraries(root):
    files = {path.relative_to(root) for path in root.rglob("*") if path.is_file()}
    programs = {path.name for path in files if "bin" in path.parts}
    assert programs == {"dipoled", "dipole"}
    assert all(".so" in path.name for path in files if "bin" not in path.parts)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can change its root")
def test_the_files_are_enough(root):
    """The daemon serves in this file system, as nobody, and the check of its health knows it."""
    assert settings("USER") == [f"{NOBODY}:{NOBODY}"]
    chroot = shutil.which("chroot", path=f"{os.environ['PATH']}:/usr/sbin")
    inside = [chroot, f"--userspec={NOBODY}:{NOBODY}", str(root)]
    place, metrics = f"tcp:127.0.0.1:{free_port()}", f"127.0.0.1:{free_port()}"
    health = json.loads(settings("HEALTHCHECK")[0].partition("CMD")[2])
    health = [word.replace("tcp:127.0.0.1:4817", place) for word in health]
    entry = json.loads(settings("ENTRYPOINT")[0])
    env = {"DIPOLED_LISTEN": place, "DIPOLED_METRICS": metrics}

    def is_healthy() -> bool:
        asked = subprocess.run([*inside, *health], capture_output=True, env={}, timeout=30, check=False)
        return asked.returncode == 0

    assert not is_healthy()
    with subprocess.Popen([*inside, *entry], env=env, stderr=subprocess.DEVNULL) as daemon:
        try:
            assert eventually(is_healthy)
            status = Path(f"/proc/{daemon.pid}/status").read_text()
            assert f"Uid:\t{NOBODY}\t{NOBODY}\t{NOBODY}\t{NOBODY}\n" in status
            with dipole.Client(place) as client, dipole.Client(f"private:{PROGRAM}") as other:
                ours = client.eval("transport", SKIN, [0.5, 1.0, 2.0])
                assert (ours.R == other.eval("transport", SKIN, [0.5, 1.0, 2.0]).R).all()
        finally:
            daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(END_S) == 0


def test_podman_builds_it():
    needs("podman")
    name = f"dipoled-test-{os.getpid()}"
    folder = BUILD / name
    make("container", CONTAINER_FOLDER=folder, CONTAINER_NAME=name)
    try:
        image = json.loads(run("podman", "image", "inspect", name))[0]
        config = image["Config"]
        assert config["User"] == f"{NOBODY}:{NOBODY}"
        assert config["Entrypoint"] == ["/usr/bin/dipoled"]
        assert image["Healthcheck"]["Test"][1] == "/usr/bin/dipole"
        assert set(config["ExposedPorts"]) == {"4817/tcp", "9817/tcp"}
    finally:
        run("podman", "rmi", name)
        run("rm", "-rf", folder)


# ---- Kubernetes ----------------------------------------------------------------------------------


def test_the_manifests_follow_the_schema_of_kubernetes():
    """The compiler finds fields that are missing, unknown or of a wrong type, and the validator what
    no type says, as that a quantity is one."""
    folder = npm_install(BUILD / "node-kubernetes", NODE_MODULES)
    script = "".join(
        f"import {{ {one['kind']} }} from 'kubernetes-models/{one['apiVersion']}';\n"
        f"new {one['kind']}({json.dumps({key: one[key] for key in ('metadata', 'spec')})}).validate();\n"
        for one in MANIFESTS
    )
    (folder / "manifests.mts").write_text(script)
    options = ["--strict", "--skipLibCheck", "--module", "nodenext", "--target", "es2022"]
    run("node_modules/.bin/tsc", *options, "manifests.mts", cwd=folder)
    run("node", "manifests.mjs", cwd=folder)


def test_the_manifests_belong_together(daemon):
    kinds = {one["kind"]: one["spec"] for one in MANIFESTS}
    assert sorted(kinds) == [
        "Deployment", "HorizontalPodAutoscaler", "PodDisruptionBudget", "Service",
    ]  # fmt: skip
    pods = kinds["Deployment"]["template"]
    labels = pods["metadata"]["labels"]
    assert kinds["Service"]["selector"] == labels
    assert kinds["Deployment"]["selector"] == kinds["PodDisruptionBudget"]["selector"]
    assert kinds["Deployment"]["selector"] == {"matchLabels": labels}
    scaled = kinds["HorizontalPodAutoscaler"]["scaleTargetRef"]
    assert scaled == {key: MANIFESTS[0][key] for key in ("apiVersion", "kind")} | {"name": "dipoled"}

    (container,) = pods["spec"]["containers"]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert [port["targetPort"] in ports for port in kinds["Service"]["ports"]] == [True]
    env = {one["name"]: one["value"] for one in container["env"]}
    places = {"DIPOLED_LISTEN": "tcp:0.0.0.0:{dipole}", "DIPOLED_METRICS": "0.0.0.0:{metrics}"}
    assert env | {key: text.format(**ports) for key, text in places.items()} == env
    env |= {key: re.sub(r"0\.0\.0\.0:\d+", "127.0.0.1:0", env[key]) for key in places}
    one = daemon(env=env, listen=[])
    for probe in ("livenessProbe", "readinessProbe"):
        asked = container[probe]["httpGet"]
        assert asked["port"] == "metrics" and fetch(one, asked["path"])[0] == 200
    metrics = kinds["HorizontalPodAutoscaler"]["metrics"]
    rules = (REPOSITORY / "clients/deploy/kubernetes.yml").read_text().partition("apiVersion")[0]
    assert all(metric["pods"]["metric"]["name"] in rules for metric in metrics)
    names = {name.partition("{")[0] for name in scrape(one)}
    assert names.issuperset(re.findall(r"seriesQuery: '(\w+)", rules))
    grace_s = pods["spec"]["terminationGracePeriodSeconds"]
    with one.client("tcp") as client:
        limits = client.info.limits
    assert grace_s * 1000 > limits["drain_timeout_ms"]
    held = limits["max_total_bytes"] + limits["cache_bytes"] + 2 * limits["points_bytes"]
    memory = container["resources"]["limits"]["memory"]
    assert memory == container["resources"]["requests"]["memory"] == "2Gi" and held < 1.7 * 2**30
