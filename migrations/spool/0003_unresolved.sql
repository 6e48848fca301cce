-- The end of a process that was killed while it sent batches which this file could not take: what of them is stored, the
-- aggregator's first answer to a later process says.

-- Of the events in `stream.counted`, those that are in a batch; NULL: not known, nothing was sent in that way.
ALTER TABLE stream ADD COLUMN taken INTEGER;

-- At most one row: no process sends in that way before it has resolved this and emptied the table.
CREATE TABLE unresolved (
    id         INTEGER PRIMARY KEY CHECK (id = 1),
    counter    TEXT NOT NULL,     -- as in `stream`, of that process, with what it sent
    counted    BLOB NOT NULL,     -- as in `stream`, when it was killed
    taken      INTEGER NOT NULL,  -- as in `stream`
    counted_ns INTEGER,           -- as in `stream`
    told       INTEGER NOT NULL,  -- as in `stream`
    events     INTEGER NOT NULL   -- in all batches that this file had had by then
) STRICT;
