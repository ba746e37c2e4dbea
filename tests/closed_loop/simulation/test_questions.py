"""Questions to a policy's process arrive as they were sent, in memory of the policy's own."""

import mmap
from multiprocessing import Pipe

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from olt_closed_loop.simulation.questions import receive_question, send_question

ARRAYS = st.lists(arrays(st.sampled_from([np.uint8, np.float64]), array_shapes(min_side=0, max_side=9)), max_size=4)


@given(first=ARRAYS, second=ARRAYS, memory=st.sampled_from([None, 4096]), turned=st.booleans())
def test_arrays_arrive_and_stay(first, second, memory, turned):
    shared = mmap.mmap(-1, memory) if memory else None
    asking, answering = Pipe()
    asked = [[array.T for array in question] if turned else question for question in (first, second)]
    heard = []
    for question in asked:
        send_question(asking, shared, ("plan", *question))
        heard.append(receive_question(answering, shared))
    for question, (name, *arrived) in zip(asked, heard, strict=True):
        assert name == "plan" and len(arrived) == len(question)
        for sent, array in zip(question, arrived, strict=True):
            np.testing.assert_array_equal(array, sent)
            assert array.dtype == sent.dtype and array.flags.writeable


@pytest.mark.parametrize("size", [4095, 4096, 4097, 100_000])
def test_what_does_not_fit_goes_through_the_pipe(size):
    shared = mmap.mmap(-1, 4096)
    asking, answering = Pipe()
    sent = np.arange(size, dtype=np.uint8)
    send_question(asking, shared, ("plan", sent))
    assert np.array_equal(receive_question(answering, shared)[1], sent)
    assert (bytes(shared[:4095]) == sent[:4095].tobytes()) == (size <= len(shared))
