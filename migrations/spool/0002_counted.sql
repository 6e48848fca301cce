-- What is known of events that never came into a batch, because their agent was killed.

-- Events in all batches before the stream's first, in the streams that were left for it; NULL: not known.
ALTER TABLE stream ADD COLUMN events_before_first INTEGER;
UPDATE stream SET events_before_first = 0 WHERE first = 1;

-- The file in shared memory in which the process that has the spool counts events when they are handed in; NULL: none.
ALTER TABLE stream ADD COLUMN counter TEXT;
-- Of the events counted there, those that are in a batch or were dropped: all, 8 bytes, then for each run its id, 16 bytes, and
-- its events, 8 bytes; integers are big-endian.
ALTER TABLE stream ADD COLUMN counted BLOB;
-- When the last of these was handed in.
ALTER TABLE stream ADD COLUMN counted_ns INTEGER;

-- Events of earlier processes that were dropped or never came into a batch, and that no gap reports yet.
CREATE TABLE unreported (
    told_through INTEGER PRIMARY KEY,  -- `stream.told` when a gap reports this and what stands before it
    pipeline     TEXT,
    run          TEXT,
    from_ns      INTEGER NOT NULL,
    to_ns        INTEGER NOT NULL,
    count        INTEGER NOT NULL,
    reason       TEXT NOT NULL
) STRICT;
