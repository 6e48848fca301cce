-- Streams carry a chain of hashes, roll-ups come in four widths of buckets, and what is old is deleted.

-- The chain of hashes over all batches up to `stored`, and the stream that this one follows after the spool was renewed.
ALTER TABLE stream ADD COLUMN chain BLOB;     -- 16 bytes; NULL before the first batch that carried one
ALTER TABLE stream ADD COLUMN previous TEXT;  -- stream.uuid
ALTER TABLE stream ADD COLUMN process INTEGER;  -- the random number of the agent's process that sent that batch; NULL: unknown

ALTER TABLE run ADD COLUMN pinned INTEGER NOT NULL DEFAULT 0;      -- 1: nothing of it is deleted
ALTER TABLE run ADD COLUMN nodes_from INTEGER NOT NULL DEFAULT 0;  -- iterations up to and including this number were deleted
ALTER TABLE run ADD COLUMN settled INTEGER NOT NULL DEFAULT 0;     -- 1: rows of `retained` were taken away, see run_resumed
CREATE INDEX run_pinned ON run (number) WHERE pinned = 1;

-- In this order of the key a commit appends to one range of rows per run and width, and a range of time is one range of
-- rows. Widths are 1, 10, 60 and 3600; those of before are 10 alone, and the program makes the coarser ones of them.
DROP VIEW stage_statistics;
ALTER TABLE rollup RENAME TO rollup_by_name;
CREATE TABLE rollup (
    run          INTEGER NOT NULL,
    resolution_s INTEGER NOT NULL,  -- width of the bucket; 0 is the whole run
    bucket_s     INTEGER NOT NULL,  -- begin of the bucket, seconds since 1970 on the edge's clock, by the iteration's start
    name         INTEGER NOT NULL,  -- name.id
    quantity     INTEGER NOT NULL,  -- 0: the value; 1: half the width of its bounds, for one-way delays
    count        INTEGER NOT NULL,
    mean         REAL NOT NULL,
    m2           REAL NOT NULL,     -- sum of squared deviations from the mean; variance = m2 / (count - 1)
    min          REAL NOT NULL,
    max          REAL NOT NULL,
    sketch       BLOB NOT NULL,     -- quantiles within 1 %
    PRIMARY KEY (run, resolution_s, bucket_s, name, quantity)
) STRICT, WITHOUT ROWID;
INSERT INTO rollup (run, resolution_s, bucket_s, name, quantity, count, mean, m2, min, max, sketch)
SELECT run, resolution_s, bucket_s, name, quantity, count, mean, m2, min, max, sketch
FROM rollup_by_name ORDER BY run, resolution_s, bucket_s, name, quantity;
DROP TABLE rollup_by_name;

CREATE VIEW stage_statistics AS
SELECT rollup.run, name.text AS name, name.unit, rollup.count, rollup.mean,
       rollup.m2 / nullif(rollup.count - 1, 0) AS variance, rollup.min, rollup.max
FROM rollup
JOIN name ON name.id = rollup.name
WHERE rollup.resolution_s = 0 AND rollup.quantity = 0;

ALTER TABLE link ADD COLUMN look_s INTEGER;  -- as retained.look_s, of its clock samples

-- What of each run has an end to its keeping. No row for what is pinned, or gone for good.
CREATE TABLE retained (
    kind   INTEGER NOT NULL,  -- 0: iterations with all that belongs to them; else the width of roll-ups' buckets
    run    INTEGER NOT NULL,  -- run.number
    look_s INTEGER,           -- its period counts from here, seconds since 1970; NULL for what has just arrived
    PRIMARY KEY (kind, run)
) STRICT, WITHOUT ROWID;
CREATE INDEX retained_by_age ON retained (kind, look_s);

-- What is not there, or not whole, because it was deleted or never made. No row where everything is there.
CREATE TABLE trimmed (
    run      INTEGER NOT NULL,  -- run.number
    kind     INTEGER NOT NULL,  -- as in retained
    before_s INTEGER NOT NULL,  -- of what began before this second, seconds since 1970 on the edge's clock
    PRIMARY KEY (run, kind)
) STRICT, WITHOUT ROWID;

-- What retention had to do that its periods did not ask for; one row for each thing.
CREATE TABLE retention_note (
    what     TEXT PRIMARY KEY,  -- size-limit
    first_ns INTEGER NOT NULL,  -- the aggregator's clock
    last_ns  INTEGER NOT NULL,  -- the aggregator's clock
    count    INTEGER NOT NULL   -- rows deleted before their time
) STRICT;

CREATE TRIGGER run_began AFTER INSERT ON run WHEN NEW.pinned = 0
BEGIN
    INSERT OR IGNORE INTO retained (kind, run) VALUES
        (0, NEW.number), (1, NEW.number), (10, NEW.number), (60, NEW.number), (3600, NEW.number);
END;

-- Data that comes after all of its kind was deleted.
CREATE TRIGGER run_resumed AFTER UPDATE OF warm_up, ok, failed, lost, timeout ON run WHEN NEW.settled = 1 AND NEW.pinned = 0
BEGIN
    INSERT OR IGNORE INTO retained (kind, run) VALUES
        (0, NEW.number), (1, NEW.number), (10, NEW.number), (60, NEW.number), (3600, NEW.number);
    UPDATE run SET settled = 0 WHERE number = NEW.number;
END;

CREATE TRIGGER run_kept AFTER UPDATE OF pinned ON run WHEN NEW.pinned = 1 AND OLD.pinned <> 1
BEGIN
    DELETE FROM retained WHERE run = NEW.number AND kind IN (0, 1, 10, 60, 3600);
END;

CREATE TRIGGER run_let_go AFTER UPDATE OF pinned ON run WHEN NEW.pinned = 0 AND OLD.pinned <> 0
BEGIN
    INSERT OR IGNORE INTO retained (kind, run) VALUES
        (0, NEW.number), (1, NEW.number), (10, NEW.number), (60, NEW.number), (3600, NEW.number);
END;

-- Runs of before. The program makes their coarser buckets when it opens the file, and takes them off this list.
CREATE TABLE rollup_debt (run INTEGER PRIMARY KEY) STRICT;
INSERT INTO rollup_debt SELECT number FROM run
WHERE EXISTS (SELECT 1 FROM rollup WHERE rollup.run = run.number AND rollup.resolution_s = 10);

INSERT INTO trimmed (run, kind, before_s)
SELECT number, 1, (SELECT max(bucket_s) + 10 FROM rollup WHERE rollup.run = run.number AND rollup.resolution_s = 10)
FROM run WHERE number IN (SELECT run FROM rollup_debt);

-- As if they had just arrived: who updates has the whole of each period to pin what must stay.
INSERT INTO retained (kind, run)
SELECT kind.column1, run.number FROM (VALUES (0), (1), (10), (60), (3600)) AS kind, run;
