"""`dipole media` and `dipole info`: the same lists in every format."""

from __future__ import annotations

import json

from command_line import dipole, read_csv


def test_media():
    rows = read_csv(dipole("media", "--format", "csv").stdout)
    assert len(rows) == 12 * 3
    skin = [row for row in rows if row["medium"] == "skin1"]
    assert [list(row.values())[1:] for row in skin] == [
        ["red", "0.032", "0.74", "0", "1.3"],
        ["green", "0.17", "0.88", "0", "1.3"],
        ["blue", "0.48", "1.01", "0", "1.3"],
    ]


def test_media_as_json_and_table():
    rows = read_csv(dipole("media", "--format", "csv").stdout)
    report = json.loads(dipole("media", "--format", "json").stdout)
    flat = [
        {"medium": medium["medium"], **channel}
        for medium in report["media"]
        for channel in medium["channels"]
    ]
    for row, other in zip(rows, flat, strict=True):
        assert (row["medium"], row["channel"]) == (other["medium"], other["channel"])
        for name in ("sigma_a", "sigma_s", "g", "eta"):
            assert float(row[name]) == other[name]
    lines = dipole("media").stdout.splitlines()
    assert lines[0].split() == ["medium", "channel", "sigma_a", "sigma_s", "g", "eta"]
    assert lines[1].split() == ["1/mm", "1/mm"]
    assert len(lines) == 3 + len(rows)
    for line, row in zip(lines[3:], rows, strict=True):
        cells = line.split()[-5:]
        assert cells[0] == row["channel"]
        assert list(map(float, cells[1:])) == list(map(float, list(row.values())[2:]))


def test_info_agrees_with_the_daemon(daemon):
    one = daemon("--workers", "1")
    report = json.loads(dipole("info", "--connect", one.url(), "--format", "json").stdout)
    assert report["address"] == one.url()
    assert report["workers"] == 1 and report["protocol_version"] == 1
    assert report["R_unit"] == "1/mm^2 per unit of power that entered"
    names = {choice["name"]: choice for choice in report["models"]}
    assert names["classical"]["id"] == 1 and names["better"]["id"] == 2
    assert "Jensen" in names["classical"]["about"]
    assert [choice["name"] for choice in report["evaluators"]][:2] == ["f64", "f32"]
    assert report["limits"]["max_frame_bytes"] > 4096
    assert report["statistics"]["requests_hello"] == 1
    with one.client() as client:
        assert report["limits"] == dict(client.info.limits)
        assert set(report["statistics"]) == set(client.statistics())


def test_info_in_every_format(daemon):
    one = daemon()
    report = json.loads(dipole("info", "--connect", one.url(), "--format", "json").stdout)
    rows = read_csv(dipole("info", "--connect", one.url(), "--format", "csv").stdout)
    table = dipole("info", "--connect", one.url()).stdout
    by_section: dict[str, dict[str, str]] = {}
    for row in rows:
        by_section.setdefault(row["section"], {})[row["name"]] = row["value"]
    assert by_section["daemon"]["software"] == report["software"]
    assert by_section["limits"] == {name: str(n) for name, n in report["limits"].items()}
    for section in ("models", "evaluators", "moments", "quantities", "spacings", "statuses"):
        expected = {choice["name"]: choice["about"] for choice in report[section]}
        assert by_section[section] == expected
        assert f"\n{section}\n" in table
        for name, about in expected.items():
            assert f"   {name} " in table and about in table
    assert set(by_section["statistics"]) == set(report["statistics"])
    for word in (report["software"], one.url(), report["instruction_set"], "limits", "statistics"):
        assert word in table
