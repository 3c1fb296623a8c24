"""Every network has a recipe, and what a caller chooses otherwise is checked."""

import pytest

from cablesense_training.errors import TrainingError
from cablesense_training.recipes import adjusted, recipe_for


def test_an_unknown_network_lists_the_known_ones():
    with pytest.raises(TrainingError, match="two-stage"):
        recipe_for("three-stage")


def test_what_is_not_chosen_stays_the_recipe():
    settings = recipe_for("two-stage").settings
    chosen = adjusted(settings, seed=4, threads=1, epochs=7)
    assert (chosen.seed, chosen.threads, chosen.epochs) == (4, 1, 7)
    assert chosen.learning_rate == settings.learning_rate


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("epochs", 0),
        ("batch_size", -1),
        ("threads", 0),
        ("learning_rate", 0.0),
        ("learning_rate", float("nan")),
        ("learning_rate", 2.0),
    ],
)
def test_refuses_what_cannot_train(option, value):
    options = {"seed": 0, "threads": 1, option: value}
    with pytest.raises(TrainingError, match=option):
        adjusted(recipe_for("two-stage").settings, **options)
