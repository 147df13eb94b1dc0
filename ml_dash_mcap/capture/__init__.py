"""What comes after `append`: the journal, its buffers, and the thread that writes them into segments."""
