"""What follows the gradients, as XLA calls it: whether they are finite, and one step of Adam in place."""

import numpy as np

from rasterizer._native.blending import ZERO
from rasterizer._native.calls import (
    argument,
    argument_rows,
    count_arguments,
    data,
    finish,
    flags,
    floats,
    map_rows,
    only_introduces,
    result,
    result_rows,
    set_word,
    share_rows,
    size,
    word,
)
from rasterizer._native.compiled import handler, inlined
from rasterizer._native.instructions import as_floats, floats_at, words_on_stack

BLOCK = 1 << 14  # numbers that a thread takes at a time
_NUMBERS, _IS_BAD = 0, 1  # of the job of `all_finite`: an address, and whether one of the numbers is not finite


@inlined
def check(job, first, count):
    """Notes a NaN or an infinity among so many numbers: zero times such a number is NaN, and any other is zero."""
    numbers, total = floats_at(as_floats(word(job, _NUMBERS)), first), ZERO
    for i in range(count):
        total += numbers[i] * ZERO
    if total != ZERO:
        set_word(job, _IS_BAD, 1)


@handler
def all_finite(frame):
    """Any number of arrays -> whether no number of theirs is NaN or infinite."""
    if only_introduces(frame):
        return 0
    job, has_memory = words_on_stack(2), True
    set_word(job, _IS_BAD, 0)
    for place in range(count_arguments(frame)):
        count = size(argument(frame, place))
        set_word(job, _NUMBERS, data(argument(frame, place)))
        if count <= BLOCK:
            check(job, 0, count)
        elif not share_rows(frame, check, job, count, BLOCK, BLOCK):
            has_memory = False
    flags(result(frame, 0))[0] = word(job, _IS_BAD) == 0
    return finish(frame, has_memory)


@inlined
def update(frame, first, count):
    """Updates so many numbers, unless the step is skipped."""
    if flags(argument(frame, 5))[0]:
        return
    parameters, gradients = result_rows(frame, 0, first, 1), argument_rows(frame, 1, first, 1)
    mu, nu, numbers = result_rows(frame, 1, first, 1), result_rows(frame, 2, first, 1), floats(argument(frame, 4))
    rate, b1, new_share_1, b2, new_share_2 = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    correction_1, correction_2, eps = numbers[5], numbers[6], numbers[7]
    for i in range(count):
        g = gradients[i]
        m = b1 * mu[i] + new_share_1 * g
        v = b2 * nu[i] + new_share_2 * (g * g)
        mu[i], nu[i] = m, v
        parameters[i] -= rate * ((m / correction_1) / (np.sqrt(v / correction_2) + eps))


@handler
def adam(frame):
    """(parameters, gradients, mu, nu, numbers, skipped) -> the first, third and fourth, in their places."""
    return map_rows(frame, update, 1, BLOCK, BLOCK)
