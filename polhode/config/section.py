"""The base of every part of the configuration, and the types that several parts share."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Share = Annotated[float, Field(ge=0, le=1)]
Seed = Annotated[int, Field(ge=0, le=10**18)]
_Length = Annotated[float, Field(ge=-1e6, le=1e6)]
Position = tuple[_Length, _Length, _Length]
"""[m]"""
Direction = tuple[_Length, _Length, _Length]
"""Of any length but zero."""
_Angle = Annotated[float, Field(ge=-3600, le=3600)]
RotationVector = tuple[_Angle, _Angle, _Angle]
"""[deg]"""
_Speed = Annotated[float, Field(ge=-1e7, le=1e7)]
Velocity = tuple[_Speed, _Speed, _Speed]
"""[mm/s]"""
_Rate = Annotated[float, Field(ge=-1000, le=1000)]
AngularVelocity = tuple[_Rate, _Rate, _Rate]
"""[deg/s] or [RPM]"""


class Section(BaseModel):
    """Frozen, and closed: an unknown key is an error, never passed in silence."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False)
