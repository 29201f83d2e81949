"""What follows the gradients, as XLA calls it: whether they are finite, and one step of Adam in place."""

import numpy as np

from rasterizer._native.blending import ZERO
from rasterizer._native.calls import (
    HANDLER,
    TASK,
    argument,
    count_arguments,
    data,
    flags,
    floats,
    item_after,
    job_of,
    let_go,
    next_item,
    no_memory,
    only_introduces,
    result,
    set_word,
    share,
    size,
    word,
)
from rasterizer._native.compiled import entry_point, inlined
from rasterizer._native.instructions import address_of, as_floats, define, floats_at, words_on_stack

BLOCK = 1 << 14  # numbers that a thread takes at a time
# Of a job: how many numbers there are; addresses of the parameters, gradients, moments and numbers of
# `rasterizer.adam`; whether a gradient is not finite.
_COUNT, _PARAMETERS, _GRADIENTS, _MU, _NU, _NUMBERS, _IS_BAD = range(7)
_JOB_WORDS = 7


@inlined
def blocks(count):
    """How many blocks so many numbers fill."""
    return (count + BLOCK - 1) // BLOCK


@inlined
def is_finite(numbers, count):
    """Whether none of so many numbers is NaN or infinite: zero times such a number is NaN, and any other is zero."""
    total = ZERO
    for i in range(count):
        total += numbers[i] * ZERO
    return total == ZERO


@entry_point(TASK)
def check_in_threads(shared):
    """Checks blocks until none is left."""
    job, item = job_of(shared), next_item(shared)
    while item >= 0:
        begin, count = item * BLOCK, min(BLOCK, word(job, _COUNT) - item * BLOCK)
        if not is_finite(floats_at(as_floats(word(job, _GRADIENTS)), begin), count):
            set_word(job, _IS_BAD, 1)
        item = item_after(shared)
    let_go(shared)


define("rasterizer_check_in_threads", check_in_threads.address)


@entry_point(HANDLER)
def all_finite(frame):
    """Any number of arrays -> whether no number of theirs is NaN or infinite."""
    if only_introduces(frame):
        return 0
    job, has_memory = words_on_stack(_JOB_WORDS), True
    set_word(job, _IS_BAD, 0)
    for place in range(count_arguments(frame)):
        count = size(argument(frame, place))
        set_word(job, _COUNT, count)
        set_word(job, _GRADIENTS, data(argument(frame, place)))
        if count <= BLOCK:
            if not is_finite(floats(argument(frame, place)), count):
                set_word(job, _IS_BAD, 1)
        elif not share(frame, address_of("rasterizer_check_in_threads"), job, blocks(count)):
            has_memory = False
    flags(result(frame, 0))[0] = word(job, _IS_BAD) == 0
    return 0 if has_memory else no_memory(frame)


@inlined
def update_block(job, begin, end):
    """Updates the numbers from `begin` to `end`."""
    parameters = floats_at(as_floats(word(job, _PARAMETERS)), begin)
    gradients = floats_at(as_floats(word(job, _GRADIENTS)), begin)
    mu, nu = floats_at(as_floats(word(job, _MU)), begin), floats_at(as_floats(word(job, _NU)), begin)
    numbers = as_floats(word(job, _NUMBERS))
    rate, b1, new_share_1, b2, new_share_2 = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    correction_1, correction_2, eps = numbers[5], numbers[6], numbers[7]
    for i in range(end - begin):
        g = gradients[i]
        m = b1 * mu[i] + new_share_1 * g
        v = b2 * nu[i] + new_share_2 * (g * g)
        mu[i], nu[i] = m, v
        parameters[i] -= rate * ((m / correction_1) / (np.sqrt(v / correction_2) + eps))


@entry_point(TASK)
def update_in_threads(shared):
    """Updates blocks until none is left."""
    job, item = job_of(shared), next_item(shared)
    while item >= 0:
        update_block(job, item * BLOCK, min((item + 1) * BLOCK, word(job, _COUNT)))
        item = item_after(shared)
    let_go(shared)


define("rasterizer_adam_in_threads", update_in_threads.address)


@entry_point(HANDLER)
def adam(frame):
    """(parameters, gradients, mu, nu, numbers, skipped) -> the first, third and fourth, in their places."""
    if only_introduces(frame):
        return 0
    if flags(argument(frame, 5))[0]:
        return 0
    job, count = words_on_stack(_JOB_WORDS), size(argument(frame, 0))
    set_word(job, _COUNT, count)
    set_word(job, _PARAMETERS, data(result(frame, 0)))
    set_word(job, _GRADIENTS, data(argument(frame, 1)))
    set_word(job, _MU, data(result(frame, 1)))
    set_word(job, _NU, data(result(frame, 2)))
    set_word(job, _NUMBERS, data(argument(frame, 4)))
    if not share(frame, address_of("rasterizer_adam_in_threads"), job, blocks(count)):
        return no_memory(frame)
    return 0
