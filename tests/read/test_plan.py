"""A plan reads every chunk that a full scan would use, and joins neighbours."""

from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.mcap import chunk_table
from ml_dash_mcap.mcap.file_index import FileIndex
from ml_dash_mcap.mcap.records import Chunk, Header
from ml_dash_mcap.query import plan


def index_of(*chunks: Chunk) -> FileIndex:
    return FileIndex("f", Header("", ""), {}, {}, chunks, {}, (), (), finished=True, end=0)


@st.composite
def indexes(draw):
    found = []
    for _ in range(draw(st.integers(0, 3))):
        chunks, at = [], 8
        for _ in range(draw(st.integers(0, 6))):
            at += draw(st.sampled_from([0, 1, chunk_table.GAP_BYTES, chunk_table.GAP_BYTES + 1]))
            times = sorted(draw(st.tuples(st.integers(0, 50), st.integers(0, 50))))
            channels = draw(st.sets(st.integers(1, 3)))
            is_indexed = draw(st.booleans())
            length = draw(st.integers(1, chunk_table.SPAN_BYTES))
            offsets = dict.fromkeys(channels, at + length) if is_indexed else {}
            chunks.append(
                Chunk(at, length, *times, "", 0, 0, offsets, 40, indexed=is_indexed and bool(offsets), counts=None)
            )
            at += length + 40
        found.append(index_of(*chunks))
    return found


@given(indexes(), st.sets(st.integers(1, 3), min_size=1), st.tuples(st.integers(0, 60), st.integers(0, 60)).map(sorted))
def test_a_plan_never_leaves_out_a_chunk_that_a_full_scan_would_use(found, wanted, times):
    start_ns, end_ns = times
    planned = plan.spans(found, [wanted] * len(found), start_ns, end_ns)
    taken = {(one.file, one.chunk.offset) for span in planned for one in span.chunks}
    for number, index in enumerate(found):
        for chunk in index.chunks:
            in_time = any(start_ns <= time <= end_ns for time in range(chunk.start_ns, chunk.end_ns + 1))
            may_hold = not chunk.indexed or wanted & set(chunk.message_index_offsets)
            assert ((number, chunk.offset) in taken) == bool(in_time and may_hold)


@given(indexes())
def test_every_chunk_and_its_indexes_lie_in_the_span_that_lists_it(found):
    for span in plan.spans(found, [None] * len(found), 0, 100):
        assert span.length == span.chunks[-1].end - span.offset
        for one in span.chunks:
            assert span.offset <= one.chunk.offset
            assert one.end <= span.offset + span.length


@given(indexes())
def test_chunks_come_by_start_time_and_those_of_one_time_in_the_order_of_writing(found):
    keys = [
        (one.chunk.start_ns, one.rank) for span in plan.spans(found, [None] * len(found), 0, 100) for one in span.chunks
    ]
    assert keys == sorted(keys)


def test_neighbours_are_read_together_and_distant_chunks_apart():
    near = Chunk(1000, 100, 1, 2, "", 0, 0, indexed=False)
    next_ = Chunk(1100 + chunk_table.GAP_BYTES, 100, 3, 4, "", 0, 0, indexed=False)
    far = Chunk(1201 + 2 * chunk_table.GAP_BYTES, 100, 5, 6, "", 0, 0, indexed=False)
    found = [(span.offset, span.length) for span in plan.spans([index_of(near, next_, far)], [None], 0, 10)]
    assert found == [(1000, 200 + chunk_table.GAP_BYTES), (far.offset, 100)]


def test_a_topic_that_a_file_does_not_have_costs_nothing():
    chunk = Chunk(8, 100, 1, 2, "", 0, 0, {1: 108}, 40)
    assert plan.spans([index_of(chunk)], [set()], 0, 10) == []
