"""What follows the gradients, as XLA calls it: whether they are finite, and one step of Adam in place."""

import numpy as np

from rasterizer._native.blending import ZERO
from rasterizer._native.calls import (
    argument,
    count_arguments,
    do_rows,
    finish,
    flags,
    floats_of,
    note_arguments,
    note_results,
    only_introduces,
    result,
    rows_of,
    set_word,
    share,
    size,
    word,
)
from rasterizer._native.compiled import handler, inlined, task
from rasterizer._native.instructions import address_of, words_on_stack

BLOCK = 1 << 14  # numbers that a thread takes at a time
# Of a job: how many numbers there are; addresses of the parameters, gradients, moments and numbers of
# `rasterizer.adam`; whether a gradient is not finite.
_COUNT, _PARAMETERS, _GRADIENTS, _MU, _NU, _NUMBERS, _IS_BAD = range(7)
_JOB_WORDS = 7


@inlined
def check(job, begin, count):
    """Notes a NaN or an infinity among so many numbers: zero times such a number is NaN, and any other is zero."""
    numbers, total = rows_of(job, _GRADIENTS, begin, 1), ZERO
    for i in range(count):
        total += numbers[i] * ZERO
    if total != ZERO:
        set_word(job, _IS_BAD, 1)


@task
def check_blocks(shared):
    """Checks blocks until none is left."""
    do_rows(shared, _COUNT, BLOCK, BLOCK, check)


@handler
def all_finite(frame):
    """Any number of arrays -> whether no number of theirs is NaN or infinite."""
    if only_introduces(frame):
        return 0
    job, has_memory = words_on_stack(_JOB_WORDS), True
    set_word(job, _IS_BAD, 0)
    for place in range(count_arguments(frame)):
        count = size(argument(frame, place))
        set_word(job, _COUNT, count)
        note_arguments(frame, place, 1, job, _GRADIENTS)
        if count <= BLOCK:
            check(job, 0, count)
        elif not share(frame, address_of("rasterizer_check_blocks"), job, (count + BLOCK - 1) // BLOCK):
            has_memory = False
    flags(result(frame, 0))[0] = word(job, _IS_BAD) == 0
    return finish(frame, has_memory)


@inlined
def update(job, begin, count):
    """Updates so many numbers."""
    parameters, gradients = rows_of(job, _PARAMETERS, begin, 1), rows_of(job, _GRADIENTS, begin, 1)
    mu, nu, numbers = rows_of(job, _MU, begin, 1), rows_of(job, _NU, begin, 1), floats_of(job, _NUMBERS)
    rate, b1, new_share_1, b2, new_share_2 = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    correction_1, correction_2, eps = numbers[5], numbers[6], numbers[7]
    for i in range(count):
        g = gradients[i]
        m = b1 * mu[i] + new_share_1 * g
        v = b2 * nu[i] + new_share_2 * (g * g)
        mu[i], nu[i] = m, v
        parameters[i] -= rate * ((m / correction_1) / (np.sqrt(v / correction_2) + eps))


@task
def update_blocks(shared):
    """Updates blocks until none is left."""
    do_rows(shared, _COUNT, BLOCK, BLOCK, update)


@handler
def adam(frame):
    """(parameters, gradients, mu, nu, numbers, skipped) -> the first, third and fourth, in their places."""
    if only_introduces(frame):
        return 0
    if flags(argument(frame, 5))[0]:
        return 0
    job, count = words_on_stack(_JOB_WORDS), size(argument(frame, 0))
    blocks = (count + BLOCK - 1) // BLOCK
    set_word(job, _COUNT, count)
    note_results(frame, 0, 1, job, _PARAMETERS)
    note_arguments(frame, 1, 1, job, _GRADIENTS)
    note_results(frame, 1, 2, job, _MU)
    note_arguments(frame, 4, 1, job, _NUMBERS)
    return finish(frame, share(frame, address_of("rasterizer_update_blocks"), job, blocks))
