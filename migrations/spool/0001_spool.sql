-- The spool of one agent: finished events that the aggregator has not acknowledged yet. Look at it with
--
--   sqlite3 -readonly spool.sqlite 'SELECT number, events, length(body) FROM batch'
--
-- Its application_id is 1347318640 (PNsp).
--
-- Units: columns named _ns are nanoseconds since 1970-01-01 UTC on the agent's wall clock.

-- The stream that the batches belong to: one row. Made with the file, so that an aggregator tells a new or copied
-- spool from the one it knows.
CREATE TABLE stream (
    id           INTEGER PRIMARY KEY CHECK (id = 1),
    uuid         TEXT NOT NULL,
    host         TEXT NOT NULL,               -- the id of the host whose events these are
    previous     TEXT,                        -- the stream that was left for this one; NULL for the file's first
    first        INTEGER NOT NULL,            -- number of the stream's first batch
    acknowledged INTEGER NOT NULL,            -- all batches up to this number are stored by the aggregator
    chain        BLOB NOT NULL,               -- chain of that batch, 16 bytes; zeros before the first
    produced     INTEGER NOT NULL DEFAULT 0,  -- events that were handed in, up to the newest batch
    dropped      INTEGER NOT NULL DEFAULT 0,  -- of those, dropped and counted in gaps
    gaps         INTEGER NOT NULL DEFAULT 0,  -- gaps that were reported
    told         INTEGER NOT NULL DEFAULT 0   -- of the events that were dropped, those that stand in a gap
) STRICT;

-- Who sent from this file: an aggregator that has a later batch of one of these processes has all up to that process's
-- number. The newest 64 are kept.
CREATE TABLE reached (
    process INTEGER PRIMARY KEY,  -- the random number that an agent's process made at its start
    number  INTEGER NOT NULL      -- of the newest batch that it may have sent
) STRICT;

-- Batches that wait, numbered without holes from `acknowledged` + 1.
CREATE TABLE batch (
    number   INTEGER PRIMARY KEY,
    since_ns INTEGER NOT NULL,  -- when its first event came
    events   INTEGER NOT NULL,  -- how many
    chain    BLOB NOT NULL,     -- SHA-256 over the chain before, the number of events and the body, cut to 16 bytes
    body     BLOB NOT NULL      -- the events one after the other, in the event stream's wire form (MessagePack)
) STRICT;
