"""The way of a row after `append`: the journal, its buffers, and the writer thread that makes segments of them."""
