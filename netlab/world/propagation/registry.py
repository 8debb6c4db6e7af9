"""Models by name: the project's own, and anybody's as `package.module:Class`."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module

from netlab.scenario.base import suggestion
from netlab.world.propagation.free_space import FreeSpace
from netlab.world.propagation.log_distance import LogDistance
from netlab.world.propagation.model import PropagationModel
from netlab.world.propagation.subt import Subt
from netlab.world.propagation.tunnel import Tunnel

#: The project's own models by their name in a scenario.
MODELS: Mapping[str, type[PropagationModel]] = {
    "free_space": FreeSpace,
    "log_distance": LogDistance,
    "tunnel": Tunnel,
    "subt": Subt,
}


def model_class(name: str) -> type[PropagationModel]:
    """Return the model called ``name``: one of ``MODELS``, or a class that Python can import as `module:Class`.

    Raises:
        ValueError: There is none, or it is no :class:`PropagationModel`; the text says what to do.
    """
    if ":" in name:
        return _imported(name)
    known = MODELS.get(name)
    if known is None:
        raise ValueError(f"unknown propagation model '{name}'; {suggestion(name, list(MODELS), 'known are')}")
    return known


def _imported(path: str) -> type[PropagationModel]:
    module_name, _, class_name = path.partition(":")
    try:
        found = getattr(import_module(module_name), class_name)
    except (ImportError, ValueError) as error:
        raise ValueError(
            f"propagation model '{path}': {error}; it must be importable, see PYTHONPATH, as package.module:Class"
        ) from None
    except AttributeError:
        raise ValueError(f"propagation model '{path}': {module_name} has no class {class_name}") from None
    if not (isinstance(found, type) and issubclass(found, PropagationModel)):
        raise ValueError(f"propagation model '{path}' must be a class derived from {PropagationModel.__module__}")
    return found
