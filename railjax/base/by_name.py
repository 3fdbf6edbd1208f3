"""What files and the command line know by name: a table of makers, whose modules are imported when they are needed."""

import importlib
from typing import Any, NamedTuple


class Maker(NamedTuple):
    """A class or function, `name`, of a module of the package, and which of the arguments at hand it is handed."""

    module: str
    name: str
    takes: tuple[str, ...] = ()

    def found(self) -> Any:
        """The class or function itself."""
        found: Any = importlib.import_module(f"..{self.module}", __package__)
        for name in self.name.split("."):
            found = getattr(found, name)
        return found

    def make(self, **given: Any) -> Any:
        """What it makes of those arguments that it takes and that are there."""
        return self.found()(**{name: given[name] for name in self.takes if given[name] is not None})
