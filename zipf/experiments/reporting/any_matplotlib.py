"""Matplotlib, whatever `MPLBACKEND` is: that of a notebook is inherited by the programs that it
starts, and keeps Matplotlib from being imported in another environment. Nothing here needs any.

Raises:
    UserError: Matplotlib cannot be imported for another reason, such as a file of its settings.
"""

import os
import sys

from zipf.errors import UserError

try:
    import matplotlib
except ValueError:
    for name in [one for one in sys.modules if one.startswith("matplotlib.")]:
        del sys.modules[name]
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib
    except ValueError as error:
        raise UserError(f"matplotlib cannot read its settings, a matplotlibrc: {error}") from None
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend

__all__ = ["matplotlib"]
