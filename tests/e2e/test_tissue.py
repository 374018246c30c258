"""Tissues by Python and HTTP: the medium of a liver is that of VTS, and evals take it."""

import dipole
import numpy as np
import pytest
from test_http import get, good, post


def test_a_tissue_is_a_medium_at_each_wavelength(client):
    liver = client.tissue([700.0, 1000.0], "liver", {"g": 0.8})
    assert liver[1].sigma_a == pytest.approx(0.067854, rel=1e-3)  # VTS, TissueTests.cs
    reduced = [one.sigma_s * (1 - one.g) for one in liver]
    assert reduced == pytest.approx([0.9 * (nm / 500) ** -0.617 for nm in (700, 1000)])
    assert np.all(np.asarray(client.eval("transport", liver, [1.0, 5.0]).R) > 0)
    assert client.tissue(1000.0, "liver", {"g": 0.8}) == liver[1:]
    by_ucl = client.tissue(1000.0, "liver", haemoglobin="ucl")
    assert by_ucl[0].sigma_a > 1.02 * liver[1].sigma_a
    for name, why in {"hbo2_um": "Did you mean hbo2_uM", "cco": "cco: not one of"}.items():
        with pytest.raises(dipole.ArgumentError, match=why):
            client.tissue(700.0, "liver", {name: 1.0})
    with pytest.raises(dipole.Refused, match=r"wavelength\[1\].*250 to 1000 nm"):
        client.tissue([700.0, 1001.0], "liver")


def test_http_has_properties_as_fields(daemon):
    one = daemon("--http", "127.0.0.1:0")
    fields = {"hbo2_uM": 56, "hb_uM": 24, "water_fraction": 0.65, "a_per_mm": 4.6, "b": 1.42}
    reply = good(post(one, "/v1/tissue", wavelength=[650, 850], haemoglobin="ucl", **fields))
    with one.client() as client:
        media = client.tissue([650, 850], None, fields, haemoglobin="ucl")
    assert reply["haemoglobin"] == "ucl" and reply["units"]["sigma_a"] == "1/mm"
    assert [dipole.Medium(**each) for each in reply["media"]] == media
    query = "&".join(f"{name}={value}" for name, value in fields.items())
    assert good(get(one, f"/v1/tissue?wavelength=650,850&haemoglobin=ucl&{query}")) == reply
    assert post(one, "/v1/tissue", wavelength=[650], hbo2=3).json["field"] == "hbo2"
    schema = good(get(one, "/v1/openapi.json"))["components"]["schemas"]["tissue_request"]
    assert {"hbo2_uM", "tissue", "wavelength", "eta"} <= set(schema["properties"])
