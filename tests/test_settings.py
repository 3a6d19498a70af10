"""Test settings as fields of dataclasses: checks by type and bounds, defaults, and the identity of results."""

from dataclasses import MISSING, dataclass

import pytest

import vibrojax as vj
from vibrojax.errors import Place
from vibrojax.settings.fields import Settings, setting


@dataclass(frozen=True, kw_only=True)
class Drawing(Settings):
    """Settings of each type."""

    size: float = setting(MISSING, "write size = 0.2", unit="m", above=0.0, below=1.0)
    count: int = setting(8, "number of lines", least=2, most=20)
    colour: str = setting("red", "colour of the lines", choices=("red", "blue"))
    thin: bool = setting(False, "whether the lines are thin", later=True)
    chunk: int | None = setting(None, "lines drawn together", least=1, results=False)
    labels: dict[str, str] = setting(dict, "texts by name")

    def check(self, place):
        if self.thin and self.colour == "red":
            raise place.at("thin").error("red lines are thick; choose another colour")


def read(**values):
    return Drawing.read(Place("drawing"), values)


def test_settings_are_completed_with_defaults():
    assert read(size=0.5, count=None) == Drawing(size=0.5)
    first, second = read(size=0.5), read(size=0.5)
    assert first.labels == {} and first.labels is not second.labels


def test_identity_has_what_results_depend_on():
    """A later setting counts where it differs from its default; one without influence on results never does."""
    plain = {"size": 0.5, "count": 8, "colour": "blue", "labels": {}}
    assert read(size=0.5, colour="blue", chunk=3).described() == plain
    assert read(size=0.5, colour="blue", thin=True).described() == plain | {"thin": True}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "drawing: size missing; write size = 0.2"),
        ({"size": 0.0}, "drawing: size: is 0; it must be above 0 m"),
        ({"size": 1.0}, "drawing: size: is 1; it must be below 1 m"),
        ({"size": "3 mm"}, 'drawing: size: "3 mm" is text; write the number alone, in m'),
        ({"size": 0.5, "count": 1}, "drawing: count: 1 does not fit; a whole number from 2 to 20 is needed"),
        ({"size": 0.5, "count": 2.5}, "drawing: count: 2.5 does not fit"),
        ({"size": 0.5, "chunk": True}, "drawing: chunk: true does not fit"),
        ({"size": 0.5, "colour": "rod"}, 'drawing: colour: "rod" is unknown; did you mean "red"?'),
        ({"size": 0.5, "thin": 1}, "drawing: thin: 1 is neither true nor false"),
        ({"size": 0.5, "conut": 3}, 'drawing: conut: unknown key; did you mean "count"?'),
        ({"size": 0.5, "thin": True}, "drawing: thin: red lines are thick; choose another colour"),
    ],
)
def test_wrong_values_are_refused_in_one_line(values, message):
    with pytest.raises(vj.InputError) as error:
        read(**values)
    assert str(error.value).startswith(message)
