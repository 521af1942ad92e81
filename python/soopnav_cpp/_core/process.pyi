"""
Process models.
"""

from __future__ import annotations
import collections.abc
import numpy.typing
import typing

__all__: list[str] = ["Process"]

class Process:
    """
    A process model: see soopnav_cpp.process. Immutable.
    """
    def __eq__(self, arg0: Process) -> bool: ...
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
    def propagate(
        self,
        state: str,
        x: numpy.typing.ArrayLike,
        dt_s: typing.SupportsFloat | typing.SupportsIndex,
        input: numpy.typing.ArrayLike | None = None,
    ) -> tuple:
        """
        One step: (x_next, F, Q) of shapes (n,), (n, n) and (n, n).
        """
    @property
    def input_size(self) -> int:
        """
        Numbers of an input; 0 when driven by nothing.
        """
    @property
    def kind(self) -> str:
        """
        Name of the model.
        """
