"""The fields of a scenario's dataclasses."""

import contextlib
import dataclasses
import math
from typing import Any

import numpy as np

from drake_nonstop.systems.documentation import meanings
from drake_nonstop.validation import warn_user


def warn_of_angles(part: Any, owner: str = "") -> None:
    """Warns of each angle beyond a turn: of a field, also in parts, whose comment begins "rad"."""
    about = meanings(type(part))
    for field in dataclasses.fields(part):
        value, path = getattr(part, field.name), f"{owner}{field.name}"
        if dataclasses.is_dataclass(value):
            warn_of_angles(value, f"{path}.")
        elif about.get(field.name, "").split(",")[0].strip() == "rad":
            with contextlib.suppress(TypeError, ValueError):  # rows of all lengths
                angles = np.asarray(value, dtype=float)
                if np.any(np.abs(angles[np.isfinite(angles)]) > 2 * math.pi):
                    hint = "an angle beyond 2π, it is in rad: degrees given?"
                    warn_user(f"{path} = {angles.tolist()}: {hint}")
