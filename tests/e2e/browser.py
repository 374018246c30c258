"""Drives Chromium over its DevTools protocol, by puppeteer-core."""

import json
import os
import queue
import shutil
import signal
import subprocess
import threading
from pathlib import Path
from typing import Any

import pytest
from daemons import BUILD, environment, sanitized
from installing import needs, npm_install

# What a browser may take for one step: a loaded machine is slow, a sanitized daemon even more.
STEP_S = 600 if sanitized() else 120

# The packages that npm fetches, if npm is installed: versions that are known to work.
NODE_MODULES = {"puppeteer-core": "25.16.0", "axe-core": "4.14.0"}

# Reads lines of JSON: {"code": the body of a function of page, browser, axe and given, "given": its
# argument, "fresh": whether it gets a page of its own}. Answers each with a line.
DRIVER = """
import puppeteer from "puppeteer-core";
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";

const [chromium, profile, limit_ms] = process.argv.slice(2);
const axe = readFileSync(new URL("node_modules/axe-core/axe.min.js", import.meta.url), "utf8");
const browser = await puppeteer.launch({
  executablePath: chromium, userDataDir: profile, pipe: true, timeout: Number(limit_ms),
  protocolTimeout: Number(limit_ms),
  args: ["--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
         "--font-render-hinting=none", ...(process.getuid() === 0 ? ["--no-sandbox"] : [])],
});
const Run = Object.getPrototypeOf(async () => {}).constructor;
let context = null, page = null;

async function open() {
  await context?.close();
  context = await browser.createBrowserContext();
  page = await context.newPage();
  page.setDefaultTimeout(Number(limit_ms));
  page.faults = [];
  page.on("console", said => said.type() === "error" && page.faults.push(said.text()));
  page.on("pageerror", error => page.faults.push(String(error)));
  await page.exposeFunction("noteViolation", what => page.faults.push(what));
  await page.evaluateOnNewDocument(() => addEventListener("securitypolicyviolation", event =>
    noteViolation(`policy: ${event.violatedDirective} ${event.blockedURI}`)));
}

for await (const line of createInterface({ input: process.stdin })) {
  const { code, given, fresh } = JSON.parse(line);
  let answer;
  try {
    if (fresh) await open();
    answer = { value: await new Run("page", "browser", "context", "axe", "given", code)(
      page, browser, context, axe, given) };
  } catch (error) {
    answer = { error: String(error.stack) };
  }
  process.stdout.write(JSON.stringify(answer) + "\\n");
}
await browser.close();
"""


class Browser:
    """A running Chromium with one page at a time."""

    def __init__(self, folder: Path):
        needs("chromium")
        modules = npm_install(BUILD / "node-page", NODE_MODULES)
        (modules / "driver.mjs").write_text(DRIVER)
        self._lines: queue.Queue[str] = queue.Queue()
        self.process = subprocess.Popen(
            ["node", "driver.mjs", shutil.which("chromium"), str(folder), str(STEP_S * 1000)],
            cwd=modules,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment(HOME=str(folder)),
            text=True,
            start_new_session=True,
        )
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self._lines.put(line)
        self._lines.put("")

    def run(self, code: str, given: Any = None, fresh: bool = False) -> Any:
        """Runs JavaScript in the driver, where `page` is puppeteer's. Returns its value."""
        self.process.stdin.write(json.dumps({"code": code, "given": given, "fresh": fresh}) + "\n")
        self.process.stdin.flush()
        line = self._lines.get(timeout=STEP_S + 30)
        assert line, "the browser has ended"
        answer = json.loads(line)
        assert "error" not in answer, answer["error"]
        return answer.get("value")

    def close(self) -> None:
        """Ends the browser, and what it has started."""
        self.process.stdin.close()
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            pass
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        self.process.wait()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """Returns a browser for the tests of one file."""
    one = Browser(tmp_path_factory.mktemp("profile"))
    yield one
    one.close()
