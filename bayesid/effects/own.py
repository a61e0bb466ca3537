"""Effects in a user's own Python file."""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

from bayesid.effects.effect import Effect
from bayesid.effects.library import MODULE, EffectLibrary
from bayesid.errors import InputError


def load_effects(path: str | Path, library: EffectLibrary | None = None) -> EffectLibrary:
    """The effects that there are, and those of a Python file.

    The file is run. Every class in it that derives from `bayesid.effects.Effect` and has a ``name`` is an effect; see
    ``docs/howto/own-effect.md``.

    Parameters
    ----------
    path
        The file.
    library
        Effects to add to; default those of the package.

    Returns
    -------
    library
        For `bayesid.load_experiment` or an `bayesid.Experiment`; nothing else knows of these effects.

    Raises
    ------
    InputError
        The file cannot be read or run, holds no effect, or one that is incomplete or whose name is taken.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the Python file that holds your effects")
    name = MODULE + str(path.resolve()).encode().hex()
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is no Python file; give one whose name ends in .py")
    module = module_from_spec(spec)
    before = sys.modules.get(name)
    sys.modules[name] = module  # dataclasses look their module up there while it runs, pickle later
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        if before is not None:
            sys.modules[name] = before
        raise InputError(f"{path}: {type(error).__name__}: {' '.join(str(error).split())}; mend the file") from error
    found = [
        c for c in vars(module).values() if isinstance(c, type) and issubclass(c, Effect) and c.__module__ == name and c.name
    ]  # fmt: skip
    if not found:
        raise InputError(f"{path}: holds no effect; derive a class with a name from bayesid.effects.JointTorqueEffect or another")
    return (library or EffectLibrary()).with_classes(found, path.name)
