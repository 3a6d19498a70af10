"""Settings as fields of dataclasses: each field declares its meaning, its unit and the values that it admits.

A class of settings is read from a table of a TOML file, from the arguments of a function, or from the words NAME=VALUE
of a command, with the same messages.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, Field, field, fields, is_dataclass
from types import NoneType
from typing import Any, ClassVar, Self, get_args

from vibrojax.errors import Place, shown
from vibrojax.physics.parameters import Parameter
from vibrojax.settings.values import choice, count, flag, known_keys, quantity

Reader = Callable[[Place, Any], Any]
"""Function that validates a value at a place, and returns it."""

COUNT_MAX = 2**31 - 1


def setting(
    default: Any,
    meaning: str,
    *,
    unit: str = "1",
    above: float | None = None,
    least: float | int | None = None,
    below: float | None = None,
    most: int = COUNT_MAX,
    choices: Collection[str] = (),
    read: Reader | None = None,
    results: bool = True,
    later: bool = False,
) -> Any:
    """Declare a setting of a class derived from [vibrojax.settings.fields.Settings][].

    **Arguments:**

    - `default`: the default; `MISSING` of `dataclasses` if the setting must be given, `dict` for an empty table.
    - `meaning`: what it is, for `--help` and messages; `unit`: unit of a number.
    - `above`, `below`: bounds that a number must not reach; `least`: bound that it may reach; `least` and `most` of a
      whole number. `choices`: the admissible names.
    - `read`: a function of the place and the value that validates the value instead, and returns it.
    - `results`: False if results do not depend on the setting, which is then no part of the identity.
    - `later`: True for a setting that an earlier version did not have. It is in the identity only where it differs from
      its default, so that earlier results keep their identity.
    """
    about = {"help": meaning, "results": results, "later": later, "is_checked": read is None}
    if read is None and choices:
        names = tuple(choices)
        read = lambda place, value: choice(place, value, names)  # noqa: E731
    if read is None:
        low = above if above is not None else least
        lowest = None if low is None else float(low)
        limits = Parameter("", 0.0, unit, "", "", lowest=lowest, open_below=above is not None, below=below)
        about |= {"limits": limits, "least": least, "most": most}
    about |= {"read": read}
    return field(default_factory=dict, metadata=about) if default is dict else field(default=default, metadata=about)


class Settings:
    """Settings that a user may write, one field for each; a subclass is a dataclass, and declares them by `setting`."""

    advice: ClassVar[Mapping[str, str]] = {}
    """Advice in the message about an unknown key."""

    @classmethod
    def read(cls, place: Place, values: Mapping[str, object]) -> Self:
        """Return the settings in `values`, validated, with defaults for the others.

        None stands for the default. **Raises:** `InputError` with the key and what would be right.
        """
        known = settings_of(cls)
        given = {name: value for name, value in values.items() if value is not None or name not in known}
        known_keys(place, given, known, cls.advice)
        required = (name for name, x in known.items() if x.default is MISSING and x.default_factory is MISSING)
        missing = [name for name in required if name not in given]
        if missing:
            raise place.error(f"{' and '.join(missing)} missing; {known[missing[0]].metadata['help']}")
        settings = cls(**{name: read_setting(place.at(name), known[name], value) for name, value in given.items()})
        settings.check(place)
        return settings

    def check(self, place: Place) -> None:
        """Raise `InputError` if settings contradict one another."""

    def checked(self, place: Place) -> Self:
        """Return the settings after a check of those with limits or choices, also if the object was made directly."""
        for name, item in settings_of(type(self)).items():
            value = getattr(self, name)
            if item.metadata.get("is_checked") and value != item.default:
                read_setting(place.at(name), item, value)
        self.check(place)
        return self

    def described(self) -> dict[str, object]:
        """Return the settings on which results depend, including defaults, as JSON values."""
        shown_values = {}
        for item in settings_of(type(self)).values():
            value = getattr(self, item.name)
            hidden = item.metadata.get("later") and value == item.default
            if item.metadata.get("results", True) and not hidden:
                shown_values[item.name] = list(value) if isinstance(value, tuple) else value
        return shown_values


def given(place: Place, value: Any) -> Any:
    """Return a value as it is: the reader of a setting that is checked later, together with others."""
    return value


def settings_of(kind: type) -> "dict[str, Field[Any]]":
    """Return the settings of a class by name: the fields of a dataclass, or none."""
    return {item.name: item for item in fields(kind)} if is_dataclass(kind) else {}


def meanings(settings: type[Settings]) -> dict[str, str]:
    """Return the meaning of each setting of a class, by name."""
    return {name: item.metadata.get("help", "") for name, item in settings_of(settings).items()}


def read_setting(place: Place, item: "Field[Any]", value: Any) -> Any:
    """Return a validated value of a field: by its reader, or else by its type and limits."""
    if (read := item.metadata.get("read")) is not None:
        return read(place, value)
    kind = next((kind for kind in (get_args(item.type) or (item.type,)) if kind is not NoneType), None)
    limits = item.metadata.get("limits")
    if kind is bool:
        return flag(place, value)
    if kind is int:
        return count(place, value, item.metadata.get("least") or 0, item.metadata.get("most"))
    if kind is float and limits is not None:
        return quantity(place, value, limits)
    if kind is str and not (isinstance(value, str) and value):
        raise place.error(f"{shown(value)} is not a name; write one")
    return value
