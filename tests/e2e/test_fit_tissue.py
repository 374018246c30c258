"""Fits of tissues over the wire: what Python, HTTP and the command line make of one set of readings."""

import numpy as np
import pytest
from dipole import ArgumentError
from test_http import post

NM = [650, 690, 730, 760, 800, 830, 850, 880, 910, 930, 970, 1000]
AT_MM = [2.0, 4.0, 7.0, 12.0]
TRUTH = {"hbo2_uM": 56, "hb_uM": 24, "water_fraction": 0.6, "fat_fraction": 0.3, "a_per_mm": 1.9, "b": 1.2}


def test_a_tissue_comes_back_with_its_saturation(daemon):
    """By another table of haemoglobin than the usual one. Sets have the same bits alone, together and over
    HTTP; one that is wrong is named."""
    one = daemon("--http", "127.0.0.1:0")
    with one.client() as client:
        ucl = {"haemoglobin": "ucl"}
        R = client.eval("transport", client.tissue(NM, properties=TRUTH, **ucl), AT_MM, evaluator="f64").R
        noisy = R * np.random.default_rng(1).normal(1, 0.01, (20, *R.shape))
        noisy[3, 2, 1] = np.nan
        fits = client.fit_tissue(list(TRUTH), NM, AT_MM, noisy, 0.01 * R, residuals=True, **ucl)
        assert list(fits.estimates) == list(TRUTH) and fits.haemoglobin == "ucl"
        assert (fits.g, fits.eta) == (0.9, 1.4)
        good = np.arange(20) != 3
        assert set(fits.status()[good]) == {"fitted"} and fits.status()[3] == "refused"
        assert (fits.sets["field"][3], fits.sets["index"][3]) == (1, 2 * len(AT_MM) + 1)
        for k, (name, estimates) in enumerate(fits.estimates.items()):
            assert set(fits.status(name)[good]) == {"fitted"}
            off = (estimates["value"] - TRUTH[name]) / estimates["error"]
            assert np.all(np.abs(off[good]) < 4.5) and np.isnan(off[3])
            assert np.allclose(fits.covariance[good, k, k], estimates["error"][good] ** 2)
        off = (fits.sets["saturation"] - 0.7) / fits.sets["saturation_error"]
        assert np.all(np.abs(off[good]) < 4.5) and np.all(fits.sets["saturation_error"][good] < 0.005)
        chi_squared = (fits.residuals**2).sum((-2, -1))
        assert np.allclose(chi_squared[good], fits.sets["chi_squared"][good])
        alone = client.fit_tissue({**dict.fromkeys(TRUTH), "b": (-0.5, 4)}, NM, AT_MM, noisy[5], 0.01 * R, **ucl)
        assert alone.sets == fits.sets[5] and np.all(alone.covariance == fits.covariance[5])
        lists = {"values": noisy[5].ravel().tolist(), "errors": (0.01 * R).ravel().tolist()}
        sought = [*list(TRUTH)[:-1], {"property": "b", "low": -0.5, "high": 4}]
        reply = post(one, "/v1/fit_tissue", sought=sought, wavelength=NM, at=AT_MM, **lists, **ucl).json
        assert [each["value"] for each in reply["estimates"]] == [e["value"] for e in alone.estimates.values()]
        assert reply["sets"][0]["saturation"] == alone.sets["saturation"] and reply["haemoglobin"] == "ucl"
        assert (reply["g"], reply["eta"]) == (0.9, 1.4)
        with pytest.raises(ArgumentError):
            client.fit_tissue(list(TRUTH), NM, AT_MM, R.T, 0.01 * R.T)
        for low, high in ((0, 1.01), (0.5, 0.5), (0.6, 0.5)):
            wrong = post(one, "/v1/fit_tissue", sought=[{"property": "water_fraction", "low": low, "high": high}],
                         wavelength=NM, at=AT_MM, **lists)  # fmt: skip
            assert wrong.status == 400 and wrong.json["field"] == "high", wrong.text


def test_amplitudes_and_phases_are_fitted_without_their_scale(daemon):
    """Python and HTTP send the same bits; a phase has no factor, and its unit is the degree."""
    one = daemon("--http", "127.0.0.1:0")
    with one.client() as client:
        media = client.tissue(NM, properties=TRUTH | {"g": 0})
        made = client.eval("transport", media, AT_MM[1:], wanted=["R", "phase", "modulation"],
                           parameters={"mhz": 80}, evaluator="f64")  # fmt: skip
        values = np.concatenate([3 * made.R * made.modulation, made.phase, made.modulation], axis=1)
        errors = np.concatenate([0.03 * made.R, made.phase * 0 + 0.2, made.phase * 0 + 0.01], axis=1)
        quantity = ["R"] * 3 + ["phase"] * 3 + ["modulation"] * 3
        fits = client.fit_tissue(
            list(TRUTH), NM, AT_MM[1:] * 3, values, errors, properties={"g": 0}, scale="free", mhz=80, quantity=quantity
        )
        assert fits.status() == "fitted" and fits.sets["factor"] == pytest.approx(3, rel=1e-3)
        for name, estimate in fits.estimates.items():
            assert abs(estimate["value"] - TRUTH[name]) < estimate["numerical"] + 1e-6
        ids = {"R": 0, "phase": 262144, "modulation": 524288}
        asked = {"wavelength": NM, "at": AT_MM[1:] * 3, "mhz": [80] * 9, "quantity": [ids[q] for q in quantity]}
        asked |= {"values": values.ravel().tolist(), "errors": errors.ravel().tolist(), "g": 0, "scale": "free"}
        reply = post(one, "/v1/fit_tissue", sought=list(TRUTH), **asked).json
        assert [each["value"] for each in reply["estimates"]] == [e["value"] for e in fits.estimates.values()]


@pytest.mark.parametrize("nm, known", [([800, 850], True), ([560, 800], False), ([800, 560], False)])
def test_fibres_reach_the_daemon_and_an_unknown_model_error_is_not_lost(daemon, nm, known):
    """The share of light within an aperture is unknown far from a fibre where blood absorbs much."""
    truth, at_mm = {"hbo2_uM": 56, "hb_uM": 24, "a_per_mm": 1.9, "b": 1.2}, [2.0, 12.0]
    one = daemon("--http", "127.0.0.1:0")
    with one.client() as client:
        R = 0.09 * client.eval("transport", client.tissue(nm, properties=truth), at_mm, evaluator="f64").R
        sought, given = ["hb_uM", "a_per_mm"], {"hbo2_uM": 56, "b": 1.2}
        fibres = {"source": [0.2, 0.3], "detector": [0.6, 0.5], "detector_na": 0.3}
        fits = client.fit_tissue(sought, nm, at_mm, R, 0.05 * R, properties=given, **fibres)
        assert np.isfinite(fits.sets["model_error"]) == known
        lists = {"values": R.ravel().tolist(), "errors": (0.05 * R).ravel().tolist()}
        reply = post(one, "/v1/fit_tissue", sought=sought, wavelength=nm, at=at_mm, **lists, **given, **fibres).json
        assert [each["value"] for each in reply["estimates"]] == [e["value"] for e in fits.estimates.values()]
