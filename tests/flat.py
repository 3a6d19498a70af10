"""The constants of a scene by name, however they are grouped, for tests that write equations of their own."""


class Flat(dict):
    """Constants by name, those of groups and the friction law's own among them; and as they are, `constants`."""

    def __init__(self, constants):
        super().__init__(_flat(constants))
        self.constants = constants
        if "weight" in self:
            self["g"] = self["weight"] * self["inverse_mass"]


def _flat(constants) -> dict:
    found = {}
    for name, value in constants._asdict().items():
        if hasattr(value, "_asdict"):
            found |= _flat(value)
        elif isinstance(value, dict):
            found |= value
        else:
            found[name] = value
    return found
