"""The page at / of --http, in a real browser."""

import csv
import io
import os
import re
import sys
import urllib.request
from pathlib import Path
from urllib.parse import urlencode

import dipole
import numpy as np
import pytest
from browser import Browser, browser  # noqa: F401  (a fixture)
from daemons import BUILD, REPOSITORY, Daemon, environment, eventually, finished, sanitized
from modbus_master import AT, Tcp, as_doubles, as_floats, words

PICTURES = BUILD / "page"
LIMIT_S = 120
OWN = "medium=&sigma_a=0.05+0.1+0.4&sigma_s=9.5+9.5+9.5&g=0.9+0.9+0.9&eta=1.4+1.4+1.4"
LINKS = {
    "measured skin": "medium=skin1&channel=2",
    "tissue in single precision": OWN + "&evaluator=f32&models=transport+quantized&r=0,0.05,1,30",
    "a colour": "by=colour&albedo=0.6+0.3+0.1&length=2+1+0.5&channel=1&models=better+burley"
    "&g=0+0+0&eta=1.4+1.4+1.4",
    "a slab by table": "medium=marble&models=multipole+better&thickness=3&evaluator=lut",
}
READINGS = (
    "r,R,error\n0.3,0.0993,0.002\n0.5,0.0489,0.001\n0.8,0.0274,0.00054\n1.2,0.01541,0.00031\n"
    "2,0.00733,0.000145\n3,0.003348,0.000067\n5,0.000976,0.00002\n8,0.0002025,0.000004\n"
)


@pytest.fixture(scope="module")
def served():
    """Returns a daemon that serves the page and Modbus at free ports."""
    one = Daemon("--http", "127.0.0.1:0", "--modbus", "tcp:127.0.0.1:0")
    yield one
    one.close()


def address(daemon) -> str:
    line = next(line for line in daemon.log if "url=http://" in line)
    return line.split("url=")[1].split()[0] + "/"


class Page:
    """The page in a browser."""

    def __init__(self, browser: Browser, url: str):  # noqa: F811
        self.browser = browser
        self.url = url

    def open(self, state: str = "", before: str = "") -> None:
        """Opens the page afresh. before: what the driver does first."""
        self.browser.run(before + "await page.goto(given)", f"{self.url}#{state}", fresh=True)
        self.settle()

    def settle(self) -> None:
        """Waits until all is answered and drawn."""
        self.run("await page.waitForFunction(() => "
                 "document.documentElement.dataset.state === 'idle')")

    def run(self, code: str, given=None):
        return self.browser.run(code, given)

    def evaluate(self, expression: str):
        return self.run("return page.evaluate(given)", expression)

    def text(self, name: str) -> str:
        return self.evaluate(f"document.getElementById('{name}').innerText")

    def rows(self, table: str) -> list[list[str]]:
        """Returns the texts of a table's cells, with those of its head first: all digits of values,
        of which four are shown."""
        return self.evaluate(f"[...document.getElementById('{table}').rows].map(row => [...row.cells]"
                             ".map(cell => cell.querySelector('span')?.title || cell.textContent))")

    def press(self, *keys: str) -> None:
        self.run("for (const key of given) await page.keyboard.press(key)", keys)

    def focus(self, name: str) -> None:
        self.run("await page.focus('#' + given)", name)

    def write(self, name: str, text: str) -> None:
        """Replaces the text of a field by the keyboard."""
        self.focus(name)
        self.run("await page.keyboard.down('Control'); await page.keyboard.press('KeyA');"
                 "await page.keyboard.up('Control'); await page.keyboard.type(given)", text)

    def values(self) -> dict[str, list[str]]:
        """Returns the column of each model in the table of values in full."""
        rows = self.rows("values")
        end = next(i for i, row in enumerate(rows) if row[0] == "albedo")
        return {name: [row[k] for row in rows[1:end]]
                for k, name in enumerate(rows[0]) if k > 0}

    def curves(self) -> list[str]:
        return self.evaluate("[...document.querySelectorAll('#cursor .curve')]"
                             ".map(curve => curve.getAttribute('d'))")

    def link(self) -> str:
        """Returns the state that a copied link holds."""
        return self.evaluate("(document.getElementById('link').click(), location.hash.slice(1))")

    def faults(self) -> list[str]:
        return self.run("return page.faults")

    def code(self, tab: str) -> str:
        """Returns what a language's tab says."""
        self.run("await page.click('#tab-' + given)", tab)
        return self.evaluate("document.getElementById('code').textContent")


@pytest.fixture
def page(browser, served):  # noqa: F811
    """Returns a page. After the test its console must have no errors."""
    one = Page(browser, address(served))
    yield one
    assert one.faults() == []


def dipole_shell(daemon, commands: str, folder: Path) -> str:
    """Runs commands that somebody has copied. Returns their output."""
    (folder / "dipole").symlink_to(BUILD / "dipole")
    done = finished(
        "sh", "-c", commands,
        env=environment(DIPOLED=daemon.url(), PATH=f"{folder}:{os.environ['PATH']}")
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def bits(texts: list[str], single: bool) -> bytes:
    return np.array([float(text) for text in texts], np.float32 if single else np.float64).tobytes()


# ---- loading -----------------------------------------------------------------------------------


def test_it_loads_without_an_error(page, served):
    page.open(before="page.urls = []; page.on('request', one => page.urls.push(one.url()));")
    assert page.evaluate("document.title").startswith("dipoled")
    assert len(page.curves()) == 6 and all(len(curve) > 500 for curve in page.curves())
    assert [row[0] for row in page.rows("legend")[1:]] == ["transport", "better", "classical"]
    urls = page.run("return page.urls")
    assert len(urls) > 5 and all(url.startswith((page.url, "data:")) for url in urls), urls


def test_its_policy_is_strict(page):
    with urllib.request.urlopen(page.url, timeout=LIMIT_S) as answer:
        headers = answer.headers
        assert b"<script src" not in answer.read()
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert headers["X-Content-Type-Options"] == "nosniff"
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe" not in policy and "*" not in policy and "frame-ancestors 'none'" in policy
    page.open()
    assert page.evaluate("""(() => {
      const script = document.createElement('script');
      try {
        script.textContent = 'window.strange = 1';
        document.body.append(script);
      } catch { }
      return window.strange === undefined; })()""")
    told = page.run("for (let i = 0; i < 3000 && !page.faults.length; i++) "
                    "await new Promise(go => setTimeout(go, 20)); return page.faults")
    assert told and all("trusted-types" in fault or "Trusted" in fault for fault in told)
    page.open()  # afresh, without these faults


# ---- controls and values -----------------------------------------------------------------------


def test_sliders_change_curves(page):
    page.open()
    for name in ["sigma_a", "sigma_s", "g", "eta"]:
        before, albedo = page.curves(), page.rows("legend")[1][4]
        field = page.evaluate(f"document.getElementById('{name}').value")
        page.focus(f"{name}_slider")
        page.press(*["ArrowRight"] * 12)
        page.settle()
        assert page.evaluate(f"document.getElementById('{name}').value") != field
        # g and sigma_s change the curves of all models, and so does the rest.
        assert all(a != b for a, b in zip(before[:3], page.curves()[:3])), name
        assert page.rows("legend")[1][4] != albedo, name
    assert page.evaluate("document.getElementById('medium').value") == ""


@pytest.mark.parametrize("link", LINKS.values(), ids=LINKS)
def test_values_are_those_of_dipole_eval(page, served, link, tmp_path):
    page.open(link)
    shown = page.values()
    commands = re.sub("^dipole eval", "dipole eval --format csv", page.code("shell"), flags=re.M)
    printed = dipole_shell(served, re.sub("(?m)^dipole invert.*", "", commands), tmp_path)
    parts = re.split("(?m)^(?=model,)", printed)[1:]  # a slab has a column more
    rows = [row for part in parts for row in csv.DictReader(io.StringIO(part))]
    assert len(shown) >= 2 and {row["model"] for row in rows} == set(shown)
    table = page.rows("values")
    evaluators = dict(zip(table[0], table[-1]))
    for model, texts in shown.items():
        expected = [row["R"] for row in rows if row["model"] == model]
        single = evaluators[model] != "f64"
        assert bits(texts, single) == bits(expected, single), model


def test_layers_above_the_medium(page, served, tmp_path):
    """Each language has the same numbers."""
    page.open("films=2,5,0.8,1.4,0.05&models=transport&evaluator=f64&r=1,2")
    shown = page.values()
    assert set(shown) == {"transport"}
    printed = dipole_shell(served, page.code("shell").replace(" eval", " eval --format csv"), tmp_path)
    assert bits(shown["transport"], False) == bits(
        [row["R"] for row in csv.DictReader(io.StringIO(printed))], False)
    assert "--layer 2,5,0.8,1.4,0.05 --layer " in page.code("shell")
    assert '"medium":[[{"sigma_a":2,' in page.code("http")
    assert "layers = [dipole.Medium(2, 5, 0.8, 1.4, 0.05), medium" in page.code("python")
    assert "query.layer_count = 2" in page.code("c")


def test_the_cursor_shows_values(page, served):
    page.open("medium=skin2&cursor=0.5")
    said = page.evaluate("document.getElementById('cursor').getAttribute('aria-valuetext')")
    radius = float(re.match("r ([0-9.]+) mm", said)[1])
    assert abs(radius / 0.5 - 1) < 0.03
    with served.client() as client:
        expected = client.eval("better", "skin2", [radius], evaluator="f64").R[0][0]
    row = next(row for row in page.rows("legend") if row[0] == "better")
    assert abs(float(row[1]) / expected - 1) < 2e-3
    page.run("const box = await (await page.$('#cursor')).boundingBox();"
             "await page.mouse.move(box.x + box.width * 0.7, box.y + 50)")
    assert page.evaluate("document.getElementById('cursor').getAttribute('aria-valuetext')") != said


def test_error_bands_are_those_of_the_daemon(page, served):
    page.open("medium=skin1&from=0.3&to=1&cursor=0.45&models=classical")
    path = 1 / (0.032 + 0.74)
    with served.client() as client:
        low, high = 0.3, 0.5 * path * 0.999999
        answer = client.eval("classical", "skin1", [low, high], wanted="R")
    shown = float(page.rows("legend")[1][2].strip("± %"))
    assert abs(shown / (100 * answer.model_error[0]) - 1) < 0.05
    assert page.evaluate("document.querySelectorAll('#cursor .band').length") >= 2
    page.open()  # near the source an error is above 100 %: a band without an end would be a block
    ends = page.evaluate("[...document.querySelectorAll('#cursor .band')].map(one => "
                         "one.getAttribute('d'))")
    assert ends and not any(re.search(r",-\d{3}", end) for end in ends)


# ---- pictures ----------------------------------------------------------------------------------


def test_pictures_are_integrals_of_R(page, served):
    page.open("medium=skin1&look=better&width=16&light=4")
    rows = [[float(cell) for cell in row] for row in page.rows("look-values")[1:]]
    with served.client() as client:
        r = np.concatenate([[0], np.geomspace(1e-4, 200, 20001)])
        answer = client.eval("better", "skin1", r, evaluator="f64", wanted=["albedo", "cdf"])
    middle = (r[1:] + r[:-1]) / 2
    for x, *rest in rows:
        edge, away, disc = rest[:3], rest[3], rest[4:]
        lit = np.arccos(np.clip(x / middle, -1, 1)) / np.pi
        with np.errstate(divide="ignore", invalid="ignore"):
            cosine = (middle**2 + away**2 - 4) / (2 * middle * away)
        inside = np.where(middle + away <= 2, 1, np.where(abs(middle - away) >= 2, 0,
                          np.arccos(np.clip(cosine, -1, 1)) / np.pi))
        for k in range(3):
            power = np.diff(answer.cdf[k]) * answer.albedo[k]
            assert edge[k] == pytest.approx((power * lit).sum(), rel=0.01, abs=1e-5)
            assert disc[k] == pytest.approx((power * inside).sum(), rel=0.02, abs=1e-5)
    red = page.evaluate("""(() => {
      const canvas = document.getElementById('edge'), context = canvas.getContext('2d');
      return [10, canvas.width - 10].map(x => context.getImageData(x, 50, 1, 1).data[0]); })()""")
    encoded = 255 * (1.055 * rows[0][1] ** (1 / 2.4) - 0.055)
    assert abs(red[0] - encoded) < 3 and red[1] < red[0] / 3


# ---- colours, readings -------------------------------------------------------------------------


def test_a_colour_gives_a_medium(page, served):
    page.open()
    page.run("await page.click('#by-colour')")
    page.write("albedo", "0.5")
    page.write("length", "2")
    page.settle()
    with served.client() as client:
        found = client.invert("better", [0.5], [2.0])
    assert f"red: sigma_a {float(found.sigma_a[0]):.4g}" in page.text("inverted")
    page.run("await page.click('#by-coefficients')")
    page.settle()
    page.focus("sigma_a")
    assert float(page.evaluate("document.getElementById('sigma_a').value")) == found.sigma_a[0]


def test_pasted_readings_are_fitted(page, served, tmp_path):
    page.open()
    page.run("await context.overridePermissions(new URL(page.url()).origin, "
             "['clipboard-read', 'clipboard-sanitized-write'])")
    page.write("fit_eta", "1.4")
    page.run("await page.evaluate(text => navigator.clipboard.writeText(text), given);"
             "await page.focus('#readings'); await page.keyboard.down('Control');"
             "await page.keyboard.press('KeyV'); await page.keyboard.up('Control')", READINGS)
    page.settle()
    (tmp_path / "readings.csv").write_text(READINGS)
    printed = dipole_shell(served, f"dipole fit {tmp_path}/readings.csv --eta 1.4 --format csv",
                           tmp_path)
    expected = next(csv.DictReader(io.StringIO(printed)))
    shown = {row[0]: row[1:] for row in page.rows("fitted")}
    assert shown["status"][0] == expected["status"] == "fitted"
    assert float(shown["sigma_a, 1/mm"][0]) == float(expected["sigma_a"])
    assert shown["g, eta"][0] == "0 (default), 1.4"
    with served.client() as client:
        table = np.loadtxt(io.StringIO(READINGS), delimiter=",", skiprows=1).T
        fits = client.fit("transport", *table, eta=1.4, residuals=True)
    residuals = page.evaluate("[...document.getElementById('residuals').tBodies[0].rows]"
                              ".map(row => Number(row.cells[4].textContent))")
    assert np.allclose(residuals, fits.residuals.ravel(), rtol=1e-3)
    assert page.evaluate("document.querySelectorAll('#fit-plot circle').length") == 16
    printed = dipole_shell(served, page.code("shell"), tmp_path / "..")
    assert full(fits.sigma_a)[:6] in printed
    page.run("await page.click('#adopt')")
    page.settle()
    page.focus("sigma_a")
    assert float(page.evaluate("document.getElementById('sigma_a').value")) == fits.sigma_a


def paste(page, text: str) -> None:
    page.evaluate(f"""(() => {{ const field = document.getElementById('readings');
      field.value = {text!r}; field.dispatchEvent(new Event('input')); }})()""")


def paste_narrow(page) -> None:
    """Pastes readings of a detector that sees a twentieth of the light."""
    table = np.loadtxt(io.StringIO(READINGS), delimiter=",", skiprows=1)
    page.write("fit_eta", "1.3")
    lines = [f"{r},{0.05 * R},{0.005 * R},0.22" for r, R, _ in table]
    paste(page, "\n".join(["r,R,error,detector_na", *lines]))
    page.settle()


def full(value) -> str:
    return repr(float(value))


def test_readings_that_are_wrong_are_told(page):
    page.open()
    for text, said in [("r,R\n1,2\n", "no column error"), ("r,R,error\n1,x,2\n", "Line 2"),
                       ("# a, b\nsample,r,R,error\n# c\n#1,1,x,1\n", "Line 4"),
                       ("r,R,error,z\n1,1,1,1\n", "Column z"), (READINGS, "Give eta")]:
        paste(page, text)
        page.run("await page.waitForFunction(said => document.getElementById('fit-problem')"
                 ".textContent.includes(said), {}, given)", said)


# ---- links, keyboard ---------------------------------------------------------------------------


SHOWN = ["legend", "values", "fitted", "residuals", "look-values"]


def everything(page) -> list:
    """Returns all that the page shows: the state of its controls first."""
    state = page.evaluate("[...document.querySelectorAll('input, select, textarea')].map(one => "
                          "[one.id, one.type === 'checkbox' || one.type === 'radio' ? one.checked "
                          ": one.value])")
    return [state, page.curves(), page.evaluate("document.getElementById('code').textContent"),
            *(page.rows(table) for table in SHOWN)]


def test_a_link_shows_the_same(page):
    page.open()
    page.run("await page.select('#medium', 'marble')")
    page.run("await page.click('#channel-1')")
    page.write("sigma_s", "3.25")
    page.run("await page.click('#model-quantized'); await page.click('#model-classical');"
             "await page.click('#tab-c')")
    page.write("r", "0.3, 0.6 1.2")
    page.write("exposure", "1.5")
    page.evaluate("document.getElementById('example').click()")
    page.settle()
    page.focus("cursor")
    page.press("ArrowRight", "PageUp")
    before = everything(page)
    page.open(page.link())
    for shown, expected in zip(everything(page), before):
        assert [one for one in zip(shown, expected) if one[0] != one[1]] == []
    page.evaluate("location.hash = 'medium=skin1'")  # another link, in the same window
    page.run("await page.waitForFunction(() => "
             "document.getElementById('medium').value === 'skin1')")
    page.settle()
    assert page.rows("legend")[1][0] == "transport"


def test_a_link_that_is_wrong_does_no_harm(page):
    page.open("medium=nothing&sigma_a=1&g=a+b+c&models=&channel=9&r=x&from=-1&tab=?&constructor=1")
    assert page.evaluate("document.getElementById('channel-2').checked")
    assert all("400 (Bad Request)" in fault for fault in page.run("return page.faults.splice(0)"))


def test_what_a_link_says_is_no_command(page, served, tmp_path):
    """A link holds the readings, and what else may go into the shell's tab."""
    hit = f"$(touch {tmp_path}/hit)"
    names = [f"a\x1bEND\x1b{hit}", f"b'`{hit}`", f'c";{hit}', f"#d,{hit}"]
    lines = READINGS.split("\n")[1:4]
    rows = [f'"{name}"\t1.4\t0\t{line.replace(",", chr(9))}' for name in names for line in lines]
    readings = "\n".join(["sample\teta\tg\tr\tR\terror", *rows])
    sly = dict.fromkeys(["fit_eta", "fit_g", "given", "inverter"], f"1;{hit}")
    page.open(urlencode({**sly, "by": "colour", "readings": readings}))
    code = page.code("shell")
    assert not re.search(r"[\0-\x09\x0b-\x1f]", code)
    printed = dipole_shell(served, code, tmp_path)
    assert [name for name in names if name.replace("\x1b", " ") not in printed] == []
    assert not (tmp_path / "hit").exists()


def reachable(page) -> list[str]:
    """Returns what the Tab key reaches, in order, by id or by what it is."""
    page.evaluate("document.activeElement.blur()")
    found: list[str] = []
    for _ in range(200):
        page.press("Tab")
        name = page.evaluate("document.activeElement === document.body ? '' : "
                             "document.activeElement.id || document.activeElement.tagName")
        if name == "" or (found and name == found[0]):
            break
        found.append(name)
    return found


def test_the_keyboard_reaches_everything(page):
    page.open()
    found = reachable(page)
    wanted = page.evaluate("""[...document.querySelectorAll(
      'button, input, select, textarea, summary, [tabindex="0"]')]
      .filter(one => one.checkVisibility() && !one.disabled && one.tabIndex >= 0
        && !(one.type === 'radio' && !one.checked)).map(one => one.id || one.tagName)""")
    assert sorted(found) == sorted(wanted)


def test_the_keyboard_does_all(page):
    page.open()
    page.run("await context.overridePermissions(new URL(page.url()).origin, "
             "['clipboard-read', 'clipboard-sanitized-write'])")
    page.focus("cursor")
    said = "document.getElementById('cursor').getAttribute('aria-valuenow')"
    places = [page.evaluate(said)]
    for key in ["ArrowRight", "PageDown", "Home", "End", "ArrowLeft"]:
        page.press(key)
        places.append(page.evaluate(said))
    assert len(set(places)) == 6 and places[3:5] == ["0", "239"]
    page.focus("channel-0")
    page.press("ArrowRight")
    page.settle()
    assert "green" in page.text("profile-title")
    page.focus("model-single")
    page.press("Space")
    page.settle()
    assert "single" in [row[0] for row in page.rows("legend")]
    page.focus("tab-shell")
    page.press("ArrowRight")
    assert page.evaluate("document.activeElement.id") == "tab-python"
    page.focus("copy")
    page.press("Enter")
    page.run("await page.waitForFunction(() => "
             "document.getElementById('copy').textContent === 'Copied')")
    copied = page.run("return page.evaluate(() => navigator.clipboard.readText())")
    assert copied == page.evaluate("document.getElementById('code').textContent")
    assert copied.startswith("import dipole")
    page.focus("theme")
    page.press("Enter")
    assert page.evaluate("document.documentElement.dataset.theme") == "light"


# ---- latency -----------------------------------------------------------------------------------


LATE = """
const client = await page.createCDPSession();
await client.send('Network.enable');
await client.send('Network.emulateNetworkConditions', { offline: false, latency: 200,
  downloadThroughput: -1, uploadThroughput: -1 });
"""


def test_requests_are_merged_while_answers_take_200_ms(page):
    page.open()
    before = int(page.evaluate("document.documentElement.dataset.asked"))
    page.run(LATE)
    page.evaluate("""(() => {
      const slider = document.getElementById('sigma_s_slider');
      for (let i = 0; i < 60; i++) {
        slider.value = 500 + i;
        slider.dispatchEvent(new Event('input'));
      } })()""")
    page.settle()
    asked = int(page.evaluate("document.documentElement.dataset.asked")) - before
    assert 15 < asked < 45  # Each of the 60 steps alone would ask 17 times.
    state = everything(page)
    page.open(page.link())
    for shown, expected in zip(everything(page)[1:], state[1:]):
        assert [one for one in zip(shown, expected) if one[0] != one[1]] == []


def test_late_answers_are_dropped(page):
    page.open()
    dropped = int(page.evaluate("document.documentElement.dataset.dropped"))
    # The answers for sigma_a = 3 wait until those for 5 are shown.
    page.run("""
      page.held = [];
      await page.setRequestInterception(true);
      page.on('request', request => {
        if (request.postData()?.includes('"sigma_a":3,')) page.held.push(request);
        else request.continue();
      });""")
    page.write("sigma_a", "3")
    page.run("while (page.held.length < 4) await new Promise(go => setTimeout(go, 20))")
    page.write("sigma_a", "5")
    page.run("await page.waitForFunction(() => "
             "document.getElementById('values').rows[0].cells.length === 4 && "
             "document.getElementById('code').textContent.includes('--sigma-a 5 '))")
    shown = page.curves()
    page.run("for (const request of page.held.splice(0)) request.continue();"
             "page.removeAllListeners('request');"
             "await page.setRequestInterception(false)")
    page.settle()
    assert page.curves() == shown
    assert int(page.evaluate("document.documentElement.dataset.dropped")) > dropped


def test_a_daemon_that_comes_back_is_used_again(browser):  # noqa: F811
    first = Daemon("--http", "127.0.0.1:0")
    url = address(first)
    page = Page(browser, url)
    page.open()
    first.close()
    page.write("sigma_a", "0.07")
    page.run("await page.waitForFunction(() => "
             "document.getElementById('away').textContent.includes('does not reply'))")
    second = Daemon("--http", url.removeprefix("http://").rstrip("/"))
    try:
        page.settle()
        assert page.text("away") == "" and "0.07" in page.evaluate("location.href")
        with second.client() as client:
            medium = dipole.Medium(0.07, 0.74, 0.0, 1.3)
            expected = client.eval("better", medium, [0.1], evaluator="f64").R[0][0]
        assert float(page.values()["better"][0]) == expected
    finally:
        page.run("await page.goto('about:blank')")
        second.close()


# ---- the same numbers elsewhere ----------------------------------------------------------------


ELSEWHERE = "medium=skin1&models=transport+better+multipole&thickness=2.5&r=0.25,0.5,4"


def assert_says_what_is_shown(page, served, folder: Path, *command: str, **variables: str) -> None:
    """Runs a program that was copied from the page; it prints the values of the page."""
    done = finished(*command, cwd=folder, env=environment(DIPOLED=served.url(), **variables))
    assert done.returncode == 0, done.stderr
    lines = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()}
    for model, texts in page.values().items():
        single = model == "transport"
        assert bits(lines[model], single) == bits(texts, single), model
    assert [float(text) for text in lines["fit"]] == [float(row[1]) for row in fitted(page)]


def test_python(page, served, tmp_path):
    page.open(ELSEWHERE)
    page.evaluate("document.getElementById('example').click()")
    page.settle()
    (tmp_path / "script.py").write_text(page.code("python"))
    paths = [str(REPOSITORY / "clients/python"), os.environ.get("PYTHONPATH", "")]
    assert_says_what_is_shown(page, served, tmp_path, sys.executable, "script.py",
                              PYTHONPATH=os.pathsep.join(paths))


def test_c(page, served, tmp_path):
    page.open(ELSEWHERE)
    paste_narrow(page)
    (tmp_path / "program.c").write_text(page.code("c"))
    sanitize = ["-fsanitize=address,undefined"] if sanitized("asan") else []
    sanitize += ["-fsanitize=thread"] if sanitized("tsan") else []
    built = finished(
        "gcc", "-Wall", "-Wextra", "-Werror", *sanitize, "program.c", "-o", "program",
        f"-I{REPOSITORY}/clients/c", f"-L{BUILD}", f"-Wl,-rpath,{BUILD}", "-ldipole", cwd=tmp_path
    )
    assert built.returncode == 0, built.stderr
    assert_says_what_is_shown(page, served, tmp_path, "./program")


def fitted(page) -> list[list[str]]:
    """Returns the rows of sigma_a and sigma_s'."""
    return page.rows("fitted")[2:4]


def test_http(page, tmp_path):
    page.open(ELSEWHERE)
    commands = page.code("http").splitlines()
    for (model, texts), command in zip(page.values().items(), commands, strict=True):
        done = finished("sh", "-c", command.replace("curl", "curl -sf", 1))
        assert f'"model":"{model}"' in done.stdout
        listed = re.search(r'"R":\[([^]]*)\]', done.stdout)[1].split(",")
        assert bits(listed, model == "transport") == bits(texts, model == "transport")


def test_modbus_fits(page, served):
    page.open()
    paste_narrow(page)
    text = page.code("modbus").partition("# the fit: ")[2]
    model, moments = re.search(r"# (\w{4}) model: transport; (\w{4}) moments", text).groups()
    with Tcp(served) as master:
        master.write(251, words(1), 2)
        master.write(101, bytes.fromhex(model), 2)
        master.write(103, bytes.fromhex(moments), 2)
        for first, part in re.findall(r"(?m)^# registers (\d+) .*\n((?:[0-9a-f]{4} .*\n)+)", text):
            data = re.findall(r"(?m)^((?:[0-9a-f]{4} )+)", part)
            master.write(int(first), bytes.fromhex("".join(data)), 2)
        assert eventually(lambda: master.read(8320, 1, 2) == words(2), LIMIT_S)
        found = as_floats(master.read(8328, 4, 2))
    assert found == pytest.approx([float(row[1]) for row in fitted(page)], rel=1e-5)


def test_modbus(page, served):
    """The words that the page lists, written as it says, give its numbers for a medium that float32
    holds exactly."""
    page.open("medium=&sigma_a=0.03125+1+1&sigma_s=0.75+1+1&g=0+0+0&eta=1.5+1+1"
              "&models=transport+better+multipole&thickness=2.5&r=0.25,0.5,4")
    text = page.code("modbus")
    sections = re.split(r"(?m)^# (\S+): write registers 100 .*$", text)[1:]
    shown = page.values()
    assert sections[::2] == list(shown)
    with Tcp(served) as master:
        for model, section in zip(sections[::2], sections[1::2]):
            master.write(251, words(1))
            slab = re.search("write ([0-9a-f ]+) to register 224", section)
            if slab:
                master.write(224, bytes.fromhex(slab[1]))
            data = re.findall(r"(?m)^([0-9a-f]{4}(?: [0-9a-f]{4})*)  #", section)
            master.write(100, bytes.fromhex("".join(data)))
            assert eventually(lambda: master.read(AT["STATUS"], 1) == words(2), LIMIT_S)
            values = as_floats(master.read(312, 6))
            assert values.tobytes() == bits(shown[model], True), model
            if "700 (40701)" in section:
                assert as_doubles(master.read(700, 12)).tobytes() == bits(shown[model], False)


# ---- accessibility and looks -------------------------------------------------------------------


LOOKS = {
    "light": {"width": 1360, "height": 900, "theme": "light"},
    "dark": {"width": 1360, "height": 900, "theme": "dark"},
    "phone": {"width": 375, "height": 812, "theme": "light"},
    "phone-dark": {"width": 375, "height": 812, "theme": "dark"},
}

SHOOT = """
await page.screenshot({ path: given + '.png', fullPage: true });
await page.screenshot({ path: given + '-top.png' });
"""


@pytest.mark.parametrize("look", LOOKS)
def test_it_is_accessible_and_looks(page, look):
    one = LOOKS[look]
    page.open(before=f"""
      await page.setViewport({{ width: {one["width"]}, height: {one["height"]} }});
      await page.emulateMediaFeatures([
        {{ name: 'prefers-color-scheme', value: '{one["theme"]}' }}]);""")
    page.evaluate("document.getElementById('example').click()")
    page.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    page.settle()
    assert page.evaluate("document.documentElement.scrollWidth") <= one["width"]
    cut = page.evaluate("[...document.querySelectorAll('pre, .scroll')].filter(one => one.scrollWidth"
                        " > one.clientWidth).map(one => getComputedStyle(one, '::after').content)")
    assert all("scroll sideways" in sign for sign in cut) and (cut or one["width"] > 1000)
    shown = page.evaluate("[...document.querySelectorAll('td, #albedos li, .number input')]"
                          ".map(one => one.value || one.textContent)")
    numbers = re.findall(r"(?<![\w.])[-±]? ?(\d[\d.]*)", "\n".join(shown))
    digits = [number.replace(".", "").strip("0") for number in numbers]
    assert len(digits) > 100 and max(map(len, digits)) <= 4
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.run(SHOOT, str(PICTURES / look))
    assert (PICTURES / f"{look}.png").stat().st_size > 50000
    found = page.run("await page.evaluate(axe); return page.evaluate(() => window.axe.run())")
    assert len(found["passes"]) > 20
    assert [(one["id"], [node["html"] for node in one["nodes"]]) for one in found["violations"]
            if one["impact"] in ("serious", "critical")] == []
