"""The notes of replies: each note is set exactly when it holds."""

import numpy as np
import pytest
from dipole import Medium
from frames import SKIN
from lists import MODELS, NOTES, medium_for

RADII = [0.5, 1.0, 2.0]


def answers(client, model: str, medium: Medium):
    return client.eval(model, medium_for(model, medium), RADII, wanted=["R", "albedo"])


@pytest.mark.parametrize("model", MODELS)
def test_similarity(client, model):
    """The note is set if, and only if, a model takes anisotropic scattering for isotropic."""
    isotropic = answers(client, model, Medium(0.05, 1.0, 0.0, 1.3))
    anisotropic = answers(client, model, Medium(0.05, 2.0, 0.5, 1.3))
    assert "similarity" not in isotropic.notes
    same = np.allclose(anisotropic.R, isotropic.R, rtol=1e-12)
    if same:
        assert ("similarity" in anisotropic.notes) != ("medium-unused" in anisotropic.notes)
    backwards = answers(client, model, Medium(0.05, 1.0, -0.2, 1.3))
    assert backwards.notes == anisotropic.notes


@pytest.mark.parametrize("model", MODELS)
def test_medium_unused(client, model):
    one = answers(client, model, Medium(*SKIN))
    other = answers(client, model, Medium(0.3, 1.1, 0.0, 1.4))
    unused = np.array_equal(one.R, other.R) and np.array_equal(one.albedo, other.albedo)
    assert ("medium-unused" in one.notes) == unused
    assert ("medium-unused" in other.notes) == unused


def test_notes_of_any_channel(client):
    both = client.eval("better", [Medium(0.1, 1.0), Medium(0.1, 1.0, 0.5)], [1.0])
    assert both.notes == ("similarity",)
    assert client.eval("better", [Medium(0.1, 1.0)] * 2, [1.0]).notes == ()


def test_notes_are_separate_bits(client):
    assert {name: note.id for name, note in client.info.choices["note"].items()} == NOTES
    assert sum(NOTES.values()) == 2 ** len(NOTES) - 1
