"""Lists and blending in one call: the lists lie in memory of the call, so that no caller has to know their length.

The passes of `lists` and `passes` run unchanged, on frames that are written here. The way back lists the splats again,
which takes less time than a caller would lose who guesses the length too short.
"""

from rasterizer._native.calls import (
    API,
    ARGUMENTS,
    BUFFER_WORDS,
    CONTEXT,
    DATA,
    DIMENSIONS,
    FRAME_WORDS,
    HANDLER,
    RESULTS,
    allocate,
    argument,
    int32s,
    length,
    no_memory,
    only_introduces,
    release,
    result,
    set_word,
    word,
)
from rasterizer._native.compiled import entry_point, inlined
from rasterizer._native.instructions import address_of, call, define, words_on_stack
from rasterizer._native.lists import lists
from rasterizer._native.passes import backward, forward

for _handler in (lists, forward, backward):
    define(f"rasterizer_pass_{_handler.__name__}", _handler.address)

# Of the lists of a call: the buffers of splats, offsets and the needed capacity; then where these keep their lengths,
# the needed capacity itself, and the table of the three buffers.
_SPLATS, _OFFSETS, _NEEDED = 0, BUFFER_WORDS, 2 * BUFFER_WORDS
_LENGTHS, _COUNT, _TABLE = 3 * BUFFER_WORDS, 3 * BUFFER_WORDS + 3, 3 * BUFFER_WORDS + 4
_LIST_WORDS = 3 * BUFFER_WORDS + 7
_LISTED = 8  # arguments of `lists`; they follow the rows


@inlined
def frame_at(place, outer, arguments, results):
    """Writes the frame of a pass within a call of XLA's, and returns its address."""
    for k in range(FRAME_WORDS):
        set_word(place, k, 0)
    set_word(place, API, word(outer, API))
    set_word(place, CONTEXT, word(outer, CONTEXT))
    set_word(place, ARGUMENTS, arguments)
    set_word(place, RESULTS, results)
    return place


@inlined
def buffer_at(place, data, lengths, count):
    """Writes the record of a buffer of `count` numbers."""
    set_word(place, DATA, data)
    set_word(place, DIMENSIONS, lengths)
    set_word(lengths, 0, count)


@inlined
def list_splats(frame, own, tiles):
    """Lists the splats into memory of this call; returns XLA's error, or 0.

    Args:
        frame: Of the call, whose second to ninth arguments are those of `lists`.
        own: Address of `_LIST_WORDS` words, written.
        tiles: How many lists there are.
    """
    for k in range(3):
        set_word(own, _TABLE + k, own + 8 * BUFFER_WORDS * k)
    buffer_at(own + 8 * _SPLATS, 0, own + 8 * _LENGTHS, 0)
    at_offsets = allocate(4 * (tiles + 1))
    buffer_at(own + 8 * _OFFSETS, at_offsets, own + 8 * (_LENGTHS + 1), tiles + 1)
    buffer_at(own + 8 * _NEEDED, own + 8 * _COUNT, own + 8 * (_LENGTHS + 2), 1)
    room = words_on_stack(FRAME_WORDS)
    arguments = word(frame, ARGUMENTS) + 8
    if at_offsets == 0:
        return no_memory(frame)
    return call(address_of("rasterizer_pass_lists"), frame_at(room, frame, arguments, own + 8 * _TABLE))


@inlined
def release_lists(own):
    """Gives back the memory of the lists."""
    release(word(own, _SPLATS + DATA))
    release(word(own, _OFFSETS + DATA))


@inlined
def name_medians(frame, own, tiles):
    """Turns places in the tiles' lists into the splats that are listed there."""
    medians, splats, offsets = int32s(result(frame, 3)), int32s(own + 8 * _SPLATS), int32s(own + 8 * _OFFSETS)
    pixels = length(result(frame, 3), 1)
    for tile in range(tiles):
        for p in range(tile * pixels, (tile + 1) * pixels):
            if medians[p] >= 0:
                medians[p] = splats[offsets[tile] + medians[p]]


@entry_point(HANDLER)
def list_and_blend(frame):
    """(rows, arguments of `lists`, sizes, rules) -> the results of `forward`, the median as a splat."""
    if only_introduces(frame):
        return 0
    own, inner, table = words_on_stack(_LIST_WORDS), words_on_stack(FRAME_WORDS), words_on_stack(5)
    tiles = length(result(frame, 1), 0)
    error = list_splats(frame, own, tiles)
    if error == 0:
        set_word(table, 0, argument(frame, 0))
        set_word(table, 1, own + 8 * _SPLATS)
        set_word(table, 2, own + 8 * _OFFSETS)
        set_word(table, 3, argument(frame, _LISTED + 1))
        set_word(table, 4, argument(frame, _LISTED + 2))
        error = call(address_of("rasterizer_pass_forward"), frame_at(inner, frame, table, word(frame, RESULTS)))
    if error == 0:
        name_medians(frame, own, tiles)
    release_lists(own)
    return error


@entry_point(HANDLER)
def list_and_unblend(frame):
    """(rows, arguments of `lists`, light, last, d_features, d_light, sizes, rules) -> d_rows, those of `backward`."""
    if only_introduces(frame):
        return 0
    own, inner, table = words_on_stack(_LIST_WORDS), words_on_stack(FRAME_WORDS), words_on_stack(9)
    error = list_splats(frame, own, length(argument(frame, _LISTED + 1), 0))
    if error == 0:
        set_word(table, 0, argument(frame, 0))
        set_word(table, 1, own + 8 * _SPLATS)
        set_word(table, 2, own + 8 * _OFFSETS)
        for k in range(6):
            set_word(table, 3 + k, argument(frame, _LISTED + 1 + k))
        error = call(address_of("rasterizer_pass_backward"), frame_at(inner, frame, table, word(frame, RESULTS)))
    release_lists(own)
    return error
