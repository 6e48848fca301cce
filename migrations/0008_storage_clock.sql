-- Incidents of the aggregator itself, a clock that no wall clock can move, and retention in the order of arrival.

-- A NULL host is new: SQLite cannot drop a NOT NULL, so the table is made anew.
ALTER TABLE incident RENAME TO incident_before;
DROP INDEX incident_by_time;
CREATE TABLE incident (
    id       INTEGER PRIMARY KEY,
    host     INTEGER REFERENCES host (id),  -- the host that reported it; NULL: the aggregator itself
    at_ns    INTEGER NOT NULL,              -- the reporting host's clock
    kind     TEXT NOT NULL,
    pipeline TEXT,
    run      INTEGER REFERENCES run (number),
    peer     INTEGER REFERENCES host (id),
    text     TEXT NOT NULL
) STRICT;
INSERT INTO incident (id, host, at_ns, kind, pipeline, run, peer, text)
SELECT id, host, at_ns, kind, pipeline, run, peer, text FROM incident_before;
DROP TABLE incident_before;
CREATE INDEX incident_by_time ON incident (at_ns, id);
-- The newest 10,000 are kept of these.
CREATE INDEX incident_of_aggregator ON incident (id) WHERE host IS NULL;

-- How long an aggregator has run and stored into this file, by its monotonic clock. Retention counts in this time alone.
CREATE TABLE storage_clock (
    id         INTEGER PRIMARY KEY CHECK (id = 1),  -- one row
    elapsed_ns INTEGER NOT NULL,
    wall_ns    INTEGER  -- the aggregator's wall clock when the row was last written; NULL: never
) STRICT;
INSERT INTO storage_clock (id, elapsed_ns) VALUES (1, 0);

-- Retention no longer counts from times of wall clocks: it deletes in the order of arrival.
DROP TRIGGER run_began;
DROP TRIGGER run_resumed;
DROP TRIGGER run_kept;
DROP TRIGGER run_let_go;
DROP TABLE retained;
ALTER TABLE run DROP COLUMN settled;
ALTER TABLE link DROP COLUMN look_s;

-- What arrived of each run and link in some time of the storage clock, by kind: a kind has at most some hundred rows of a
-- run within its period. No row for what is pinned, or gone.
CREATE TABLE arrival (
    kind   INTEGER NOT NULL,  -- 0: iterations with all that belongs to them; -1: clock samples; else the width of roll-ups
    owner  INTEGER NOT NULL,  -- run.number; link.id of clock samples
    from_s INTEGER NOT NULL,  -- storage clock, seconds, when the first of it was stored; 0: before all others
    to_s   INTEGER NOT NULL,  -- storage clock, seconds, when the last of it had been stored: its period counts from here
    first  INTEGER NOT NULL,  -- the smallest iteration.number, clock_sample.at_ns or rollup.bucket_s of it
    last   INTEGER NOT NULL,  -- the greatest; what a later row of the same owner holds as well belongs to that one
    PRIMARY KEY (kind, owner, from_s)
) STRICT, WITHOUT ROWID;
CREATE INDEX arrival_by_age ON arrival (kind, to_s);

-- What arrived since the newest row of `arrival`; all NULL: nothing.
ALTER TABLE run ADD COLUMN arriving_from_s INTEGER;        -- storage clock, seconds
ALTER TABLE run ADD COLUMN arriving_first_number INTEGER;  -- iteration.number
ALTER TABLE run ADD COLUMN arriving_last_number INTEGER;
ALTER TABLE run ADD COLUMN arriving_first_s INTEGER;       -- the seconds in which these iterations began, on the edge's clock
ALTER TABLE run ADD COLUMN arriving_last_s INTEGER;
CREATE INDEX run_arriving ON run (arriving_from_s) WHERE arriving_from_s IS NOT NULL;
ALTER TABLE link ADD COLUMN arriving_from_s INTEGER;       -- storage clock, seconds
ALTER TABLE link ADD COLUMN arriving_first_ns INTEGER;     -- clock_sample.at_ns
ALTER TABLE link ADD COLUMN arriving_last_ns INTEGER;
CREATE INDEX link_arriving ON link (arriving_from_s) WHERE arriving_from_s IS NOT NULL;

CREATE TRIGGER run_kept AFTER UPDATE OF pinned ON run WHEN NEW.pinned = 1 AND OLD.pinned <> 1
BEGIN
    DELETE FROM arrival WHERE owner = NEW.number AND kind IN (0, 1, 10, 60, 3600);
END;

CREATE TRIGGER run_let_go AFTER UPDATE OF pinned ON run WHEN NEW.pinned = 0 AND OLD.pinned <> 0
BEGIN
    INSERT OR REPLACE INTO arrival (kind, owner, from_s, to_s, first, last)
    SELECT kind.column1, NEW.number, 0, elapsed_ns / 1000000000, -9223372036854775808, 9223372036854775807
    FROM (VALUES (0), (1), (10), (60), (3600)) AS kind, storage_clock;
END;

-- As if all had just arrived: who updates has the whole of each period to pin what must stay.
INSERT INTO arrival (kind, owner, from_s, to_s, first, last)
SELECT kind.column1, run.number, 0, 0, -9223372036854775808, 9223372036854775807
FROM (VALUES (0), (1), (10), (60), (3600)) AS kind, run WHERE run.pinned = 0;
INSERT INTO arrival (kind, owner, from_s, to_s, first, last)
SELECT -1, id, 0, 0, -9223372036854775808, 9223372036854775807 FROM link;
