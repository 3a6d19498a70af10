"""Constants of a scene by name, however they are grouped, for tests that write their own equations."""


class Flat(dict):
    """Constants by name, including those of groups and of the friction law. `constants` holds the original."""

    def __init__(self, constants):
        super().__init__(_flat(constants))
        self.constants = constants
        if "weight" in self:
            self["g"] = self["weight"] * self["inverse_m1"]


def _flat(constants) -> dict:
    flat = {}
    for name, value in constants._asdict().items():
        if hasattr(value, "_asdict"):
            flat |= _flat(value)
        elif isinstance(value, dict):
            flat |= value
        else:
            flat[name] = value
    return flat
