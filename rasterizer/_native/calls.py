"""A call from XLA: its arguments and results, and the threads that share its work.

XLA calls a C function with a frame (`xla/ffi/api/c_api.h`, which jaxlib ships; version 0.3); what is read of it here
are words at fixed places. No Python runs in a call, and no lock of Python's is taken. The work is shared with XLA's own
threads: a free thread takes the next item. A late thread finds no item left, so that no thread waits for a busy one.
"""

from rasterizer._native.compiled import API_MAJOR, API_MINOR, inlined
from rasterizer._native.instructions import (
    address_of,
    as_bytes,
    as_floats,
    as_int32s,
    as_int64s,
    call,
    code_of,
    fetch_add,
    floats_at,
    words_on_stack,
)

# Places of what is read, in words of 8 bytes.
_EXTENSION, _API, _CONTEXT, _COUNT, ARGUMENTS, _RESULTS = 1, 2, 3, 7, 9, 14  # of a frame
_DATA, _RANK, _DIMENSIONS = 3, 4, 5  # of a buffer
_CREATE_ERROR, _DESTROY_ERROR, _SCHEDULE, _COUNT_THREADS = 6, 8, 17, 18  # of the table of XLA's functions
_RESOURCE_EXHAUSTED = 8
# Of what threads share: how many hold it, the next item, the items that are done, all items, and their job; of rows how
# many there are, those of an item, and those that are done at once.
_HOLDERS, _NEXT, _DONE, _ITEMS, _JOB, _ROWS, _BLOCK, _STRIP = range(8)
_SHARED_WORDS = 8


@inlined
def word(address, place):
    """The word at so many words behind an address."""
    return as_int64s(address)[place]


@inlined
def set_word(address, place, value):
    """Writes a word."""
    as_int64s(address)[place] = value


@inlined
def set_words(address, place, *values):
    """Writes words from a place on."""
    for i in range(len(values)):
        set_word(address, place + i, values[i])


@inlined
def argument(frame, place):
    """The record of an argument's buffer."""
    return word(word(frame, ARGUMENTS), place)


@inlined
def count_arguments(frame):
    """Number of arguments."""
    return word(frame, _COUNT)


@inlined
def result(frame, place):
    """The record of a result's buffer."""
    return word(word(frame, _RESULTS), place)


@inlined
def data(buffer):
    """Address of a buffer's numbers."""
    return word(buffer, _DATA)


@inlined
def length(buffer, axis):
    """Length of a buffer along an axis."""
    return word(word(buffer, _DIMENSIONS), axis)


@inlined
def size(buffer):
    """How many numbers a buffer holds."""
    total = 1
    for axis in range(word(buffer, _RANK)):
        total *= length(buffer, axis)
    return total


@inlined
def floats(buffer):
    """A buffer's float32 numbers."""
    return as_floats(data(buffer))


@inlined
def int32s(buffer):
    """A buffer's int32 numbers."""
    return as_int32s(data(buffer))


@inlined
def flags(buffer):
    """A buffer's booleans, as bytes."""
    return as_bytes(data(buffer))


@inlined
def argument_rows(frame, place, row, width):
    """The float32 numbers of an argument, from a row on."""
    return floats_at(floats(argument(frame, place)), row * width)


@inlined
def result_rows(frame, place, row, width):
    """The same of a result."""
    return floats_at(floats(result(frame, place)), row * width)


@inlined
def int32s_of(job, place):
    """The int32 numbers at an address of a job."""
    return as_int32s(word(job, place))


@inlined
def allocate(size):
    """Address of so many fresh bytes; 0 where there are none left."""
    return call(address_of("rasterizer_allocate"), max(size, 1))


@inlined
def release(address):
    """Gives back what `allocate` gave."""
    call(address_of("rasterizer_release"), address)


@inlined
def only_introduces(frame):
    """Whether XLA only requests the version of its interface that this is written for, which is then written."""
    extension = word(frame, _EXTENSION)
    if extension == 0 or as_int32s(extension)[2] != 1:
        return False
    metadata = as_int32s(word(extension, 3))
    metadata[6], metadata[7], metadata[8] = API_MAJOR, API_MINOR, 0
    return True


@inlined
def finish(frame, had_memory):
    """What a call returns: 0, or an error where `allocate` found nothing."""
    if had_memory:
        return 0
    request = words_on_stack(4)
    set_words(request, 0, 28, 0, address_of("rasterizer_no_memory"), _RESOURCE_EXHAUSTED)
    return call(word(word(frame, _API), _CREATE_ERROR), request)


@inlined
def map_rows(frame, do, width, block, strip):
    """What a handler returns that does all rows of the first argument, by `do(frame, first row, at most strip)`.

    A row has `width` numbers; a thread takes a block of them at a time.
    """
    if only_introduces(frame):
        return 0
    return finish(frame, share_rows(frame, do, frame, size(argument(frame, 0)) // width, block, strip))


@inlined
def share(frame, do, job, items):
    """Does all items of a job, by `do(job, item)`, with as many of XLA's threads as come to help.

    The job is a word. Returns whether there was memory to begin.
    """
    return _share(frame, code_of(_do_items, do), items, job, items, 1, 1)


@inlined
def share_rows(frame, do, job, rows, block, strip):
    """The same by `do(job, first row, at most strip)`, of so many rows; a thread takes a block of them at a time."""
    return _share(frame, code_of(_do_rows, do), (rows + block - 1) // block, job, rows, block, strip)


@inlined
def _share(frame, task, items, job, rows, block, strip):
    """Has threads call a task until all items are done."""
    shared, helpers = allocate(8 * _SHARED_WORDS), max(min(_threads(frame), items) - 1, 0)
    if shared == 0:
        return False
    set_words(shared, _HOLDERS, helpers + 2, 0, 0, items, job, rows, block, strip)
    fetch_add(shared + 8 * _HOLDERS, _schedule_helpers(frame, task, shared, helpers) - helpers)
    call(task, shared)
    while fetch_add(shared + 8 * _DONE, 0) < items:
        call(address_of("rasterizer_give_way"), 0)
    _let_go(shared)
    return True


@inlined
def _do_items(shared, do):
    """Does items that no thread has taken, until none is left, and lets go."""
    item = fetch_add(shared + 8 * _NEXT, 1)
    while item < word(shared, _ITEMS):
        do(word(shared, _JOB), item)
        fetch_add(shared + 8 * _DONE, 1)
        item = fetch_add(shared + 8 * _NEXT, 1)
    _let_go(shared)


@inlined
def _do_rows(shared, do):
    """The same of blocks of rows, a strip at a time."""
    item = fetch_add(shared + 8 * _NEXT, 1)
    while item < word(shared, _ITEMS):
        job, block, strip = word(shared, _JOB), word(shared, _BLOCK), word(shared, _STRIP)
        end = min((item + 1) * block, word(shared, _ROWS))
        for first in range(item * block, end, strip):
            do(job, first, min(strip, end - first))
        fetch_add(shared + 8 * _DONE, 1)
        item = fetch_add(shared + 8 * _NEXT, 1)
    _let_go(shared)


@inlined
def _let_go(shared):
    """The last one to let go gives back what was shared."""
    if fetch_add(shared + 8 * _HOLDERS, -1) == 1:
        release(shared)


@inlined
def _threads(frame):
    """Threads that XLA has, this one among them; 1 where the number is unknown."""
    count, request = words_on_stack(1), words_on_stack(4)
    set_word(count, 0, 1)
    set_words(request, 0, 32, 0, word(frame, _CONTEXT), count)
    _forget(frame, call(word(word(frame, _API), _COUNT_THREADS), request))
    return word(count, 0)


@inlined
def _schedule_helpers(frame, task, shared, helpers):
    """How many threads were scheduled to help."""
    request = words_on_stack(5)
    set_words(request, 0, 40, 0, word(frame, _CONTEXT), task, shared)
    for scheduled in range(helpers):
        if _forget(frame, call(word(word(frame, _API), _SCHEDULE), request)):
            return scheduled
    return helpers


@inlined
def _forget(frame, error):
    """Whether there was an error of XLA's. It is thrown away: this thread then works alone."""
    if error == 0:
        return False
    request = words_on_stack(3)
    set_words(request, 0, 24, 0, error)
    call(word(word(frame, _API), _DESTROY_ERROR), request)
    return True
