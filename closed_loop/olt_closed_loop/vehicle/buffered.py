"""Calls of CasADi functions that skip its conversion of arguments, which costs more than small functions do."""

from typing import Any

import casadi as ca
import numpy as np

from olt_generator.poses import Array


class BufferedFunction:
    """A CasADi function that reads and writes fixed numpy buffers.

    CasADi stores matrices by columns: an argument or result that it knows as (rows, columns) is here an array
    (columns, rows), and a column vector is an array (rows,). Not for use by several threads at once.
    """

    def __init__(self, function: ca.Function) -> None:
        self.name = function.name()
        self._inputs = [np.zeros(_shape(function.size_in(i))) for i in range(function.n_in())]
        self._outputs = [np.zeros(_shape(function.size_out(i))) for i in range(function.n_out())]
        self._buffer: Any  # CasADi's type stubs ask for a size that the call itself takes from the array
        self._buffer, self._evaluate = function.buffer()
        for index, array in enumerate(self._inputs):
            self._buffer.set_arg(index, array.data)
        for index, array in enumerate(self._outputs):
            self._buffer.set_res(index, array.data)

    def __call__(self, *arguments: Array | float) -> list[Array]:
        """Evaluate; the results are copies."""
        for buffer, argument in zip(self._inputs, arguments, strict=True):
            buffer[...] = argument
        self._evaluate()
        return [output.copy() for output in self._outputs]


def _shape(size: tuple[int, int]) -> tuple[int, ...]:
    rows, columns = size
    return (rows,) if columns == 1 else (columns, rows)
