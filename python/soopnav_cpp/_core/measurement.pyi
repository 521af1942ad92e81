"""
Measurement models.
"""

from __future__ import annotations
import collections.abc
import numpy.typing
import typing

__all__: list[str] = ["Measurement"]

class Measurement:
    """
    A measurement model: see soopnav_cpp.measurement. Immutable.
    """
    def __eq__(self, arg0: Measurement) -> bool: ...
    def __getstate__(self) -> tuple[str, list[tuple[str, list[float]]]]: ...
    def __hash__(self) -> int: ...
    def __init__(
        self,
        kind: str,
        parameters: collections.abc.Sequence[
            tuple[str, collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex]]
        ],
    ) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def predict(self, state: str, x: numpy.typing.ArrayLike) -> tuple:
        """
        Value and Jacobian at a state: (h, H) of shapes (m,) and (m, n). ValueError where undefined.
        """
    @property
    def kind(self) -> str:
        """
        Name of the model.
        """
    @property
    def rows(self) -> int:
        """
        Numbers of one measurement.
        """
