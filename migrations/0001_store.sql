-- The store of one aggregator. Open the file with `sqlite3 -readonly peernet.sqlite` and try
--
--   SELECT * FROM run_list;
--   SELECT * FROM stage_statistics WHERE run = 1;
--   SELECT * FROM stage_ms WHERE run = 1 AND iteration = 17;
--
-- Units: columns named _ns are nanoseconds. Instants are nanoseconds since 1970-01-01 UTC on the wall clock of
-- the host that reported them, and on the aggregator's where the comment says so. Values are in SI units
-- (seconds, bytes, bits per second). What is not known is NULL.

-- Words behind the small numbers.
CREATE TABLE outcome (id INTEGER PRIMARY KEY, text TEXT NOT NULL) STRICT;
INSERT INTO outcome VALUES (0, 'ok'), (1, 'failed'), (2, 'lost'), (3, 'timeout');

CREATE TABLE verdict (id INTEGER PRIMARY KEY, text TEXT NOT NULL) STRICT;
INSERT INTO verdict VALUES (0, 'ok'), (1, 'limited'), (2, 'stale'), (3, 'unsynchronised'), (4, 'stepped'), (5, 'inconsistent');

CREATE TABLE source (id INTEGER PRIMARY KEY, text TEXT NOT NULL) STRICT;
INSERT INTO source VALUES (0, 'same-clock'), (1, 'in-band'), (2, 'kernel'), (3, 'chrony'), (4, 'intersection'), (5, 'none');

-- What nodes are called: a name with its kind and unit, so that a node costs one small number for all three.
CREATE TABLE name (
    id     INTEGER PRIMARY KEY,
    text   TEXT NOT NULL,
    kind   TEXT NOT NULL,     -- container, timer, transit, value, throughput, token-rate, or a user's own
    custom INTEGER NOT NULL,  -- 1 for a user's own kind
    unit   TEXT NOT NULL,
    UNIQUE (text, kind, custom, unit)
) STRICT;

-- Every host ever heard of. `name` and `description` are NULL for one known only from other hosts' trees.
CREATE TABLE host (
    id            INTEGER PRIMARY KEY,
    uuid          TEXT NOT NULL UNIQUE,
    name          TEXT,
    description   TEXT,              -- JSON, as the host introduced itself last
    first_seen_ns INTEGER NOT NULL,  -- the aggregator's clock
    last_seen_ns  INTEGER NOT NULL,  -- the aggregator's clock
    events        INTEGER NOT NULL DEFAULT 0,  -- stored
    nodes         INTEGER NOT NULL DEFAULT 0,  -- stored
    gaps          INTEGER NOT NULL DEFAULT 0,
    missing       INTEGER NOT NULL DEFAULT 0,  -- events in those gaps, as far as they could be counted
    quarantined   INTEGER NOT NULL DEFAULT 0   -- batches put aside
) STRICT;

CREATE TABLE pipeline (
    id   INTEGER PRIMARY KEY,
    host INTEGER NOT NULL REFERENCES host (id),
    name TEXT NOT NULL,
    UNIQUE (host, name)
) STRICT;

-- Numbered batches arrive in streams. A batch and the stream's new mark are committed together: that is what
-- makes "exactly once" out of "sent again until acknowledged".
CREATE TABLE stream (
    id            INTEGER PRIMARY KEY,
    uuid          TEXT NOT NULL UNIQUE,
    host          INTEGER NOT NULL REFERENCES host (id),
    stored        INTEGER NOT NULL,  -- all batches up to this number are stored
    first_seen_ns INTEGER NOT NULL,  -- the aggregator's clock
    last_seen_ns  INTEGER NOT NULL   -- the aggregator's clock
) STRICT;

-- AUTOINCREMENT: a number that people have quoted never comes to mean another run.
CREATE TABLE run (
    number            INTEGER PRIMARY KEY AUTOINCREMENT,
    uuid              TEXT NOT NULL UNIQUE,
    pipeline          INTEGER NOT NULL REFERENCES pipeline (id),
    started_ns        INTEGER NOT NULL,
    ended_ns          INTEGER,
    end_reason        TEXT,
    placement         TEXT NOT NULL,  -- local or remote
    peer              TEXT,           -- name of the serving host
    network           TEXT,
    address           TEXT,
    model             TEXT NOT NULL,
    device            TEXT,
    facts             TEXT NOT NULL,  -- JSON: pairs for people
    configuration     TEXT NOT NULL,  -- TOML
    version           TEXT NOT NULL,
    last_iteration_ns INTEGER,
    warm_up           INTEGER NOT NULL DEFAULT 0,  -- iterations of the warm-up
    ok                INTEGER NOT NULL DEFAULT 0,  -- iterations by outcome, without the warm-up
    failed            INTEGER NOT NULL DEFAULT 0,
    lost              INTEGER NOT NULL DEFAULT 0,
    timeout           INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE INDEX run_of_pipeline ON run (pipeline, number);

CREATE TABLE iteration (
    run        INTEGER NOT NULL REFERENCES run (number),
    number     INTEGER NOT NULL,
    episode    INTEGER NOT NULL,
    step       INTEGER NOT NULL,
    warm_up    INTEGER NOT NULL,
    outcome    INTEGER NOT NULL,
    reason     TEXT,
    started_ns INTEGER NOT NULL,  -- the zero of the edge's nodes
    total      REAL,              -- seconds
    PRIMARY KEY (run, number)
) STRICT, WITHOUT ROWID;
CREATE INDEX iteration_by_total ON iteration (run, warm_up, outcome, total);
CREATE INDEX iteration_without_answer ON iteration (run, number) WHERE outcome <> 0;

-- The tree of each iteration, flat, parents before children. No foreign keys from here down: one writer inserts
-- an iteration and its nodes in one statement group of one transaction, and a look-up per node would halve its speed.
CREATE TABLE node (
    run       INTEGER NOT NULL,
    iteration INTEGER NOT NULL,
    node      INTEGER NOT NULL,  -- position in the tree, 0 is the root
    parent    INTEGER,           -- position of the parent
    name      INTEGER NOT NULL,  -- name.id
    host      INTEGER NOT NULL,  -- 0 is the edge, others: anchor.position
    start_ns  INTEGER NOT NULL,  -- on that host's monotonic clock, from that host's zero
    value     REAL,
    lo        REAL,              -- bounds of one-way delays and of what follows from them
    hi        REAL,
    PRIMARY KEY (run, iteration, node)
) STRICT, WITHOUT ROWID;

-- The other hosts in an iteration's tree. The edge is not here: its zero is iteration.started_ns.
CREATE TABLE anchor (
    run       INTEGER NOT NULL,
    iteration INTEGER NOT NULL,
    position  INTEGER NOT NULL,
    host      INTEGER NOT NULL,  -- host.id
    wall_ns   INTEGER NOT NULL,  -- that host's wall clock at the zero of its nodes
    PRIMARY KEY (run, iteration, position)
) STRICT, WITHOUT ROWID;

-- What was stamped for the nodes of kind transit, kept so that the correction can be redone.
CREATE TABLE transit (
    run         INTEGER NOT NULL,
    iteration   INTEGER NOT NULL,
    node        INTEGER NOT NULL,
    sent_ns     INTEGER NOT NULL,  -- the sender's wall clock
    received_ns INTEGER,           -- the receiver's wall clock; NULL when it never arrived
    raw_ns      INTEGER,           -- received minus sent as judged; may be negative: two clocks
    source      INTEGER,           -- source.id
    verdict     INTEGER,           -- verdict.id
    PRIMARY KEY (run, iteration, node)
) STRICT, WITHOUT ROWID;

-- Statistics that grow with the nodes, in the same transaction. Successful iterations only, warm-up left out.
CREATE TABLE rollup (
    run          INTEGER NOT NULL,
    resolution_s INTEGER NOT NULL,  -- width of the bucket; 0 is the whole run
    name         INTEGER NOT NULL,  -- name.id
    quantity     INTEGER NOT NULL,  -- 0: the value; 1: half the width of its bounds, for one-way delays
    bucket_s     INTEGER NOT NULL,  -- begin of the bucket, seconds since 1970 on the edge's clock, by the iteration's start
    count        INTEGER NOT NULL,
    mean         REAL NOT NULL,
    m2           REAL NOT NULL,     -- sum of squared deviations from the mean; variance = m2 / (count - 1)
    min          REAL NOT NULL,
    max          REAL NOT NULL,
    sketch       BLOB NOT NULL,     -- quantiles within 1 %
    PRIMARY KEY (run, resolution_s, name, quantity, bucket_s)
) STRICT, WITHOUT ROWID;

-- How often each verdict was given in a run.
CREATE TABLE verdict_count (
    run     INTEGER NOT NULL,
    name    INTEGER NOT NULL,  -- name.id
    verdict INTEGER NOT NULL,  -- verdict.id
    count   INTEGER NOT NULL,
    PRIMARY KEY (run, name, verdict)
) STRICT, WITHOUT ROWID;

CREATE TABLE incident (
    id       INTEGER PRIMARY KEY,
    host     INTEGER NOT NULL REFERENCES host (id),
    at_ns    INTEGER NOT NULL,
    kind     TEXT NOT NULL,
    pipeline TEXT,
    run      INTEGER REFERENCES run (number),
    peer     INTEGER REFERENCES host (id),
    text     TEXT NOT NULL
) STRICT;
CREATE INDEX incident_by_time ON incident (at_ns, id);

-- Events that never arrived.
CREATE TABLE gap (
    id       INTEGER PRIMARY KEY,
    host     INTEGER NOT NULL REFERENCES host (id),
    pipeline TEXT,
    run      INTEGER REFERENCES run (number),
    from_ns  INTEGER NOT NULL,
    to_ns    INTEGER NOT NULL,
    count    INTEGER NOT NULL,  -- 0 when not known
    reason   TEXT NOT NULL
) STRICT;
CREATE INDEX gap_of_run ON gap (run, from_ns);

-- Batches that could not be stored as they were; the newest thousand are kept.
CREATE TABLE quarantine (
    id          INTEGER PRIMARY KEY,
    host        INTEGER NOT NULL REFERENCES host (id),
    stream      TEXT NOT NULL,
    number      INTEGER NOT NULL,
    received_ns INTEGER NOT NULL,  -- the aggregator's clock
    events      INTEGER,           -- NULL when the batch cannot even be read
    reason      TEXT NOT NULL,
    frame       BLOB NOT NULL      -- the message, MessagePack
) STRICT;

-- For people.

CREATE VIEW stage_ms AS
SELECT node.run, node.iteration, node.node, name.text AS name,
       round(node.value * 1e3, 3) AS ms, round(node.lo * 1e3, 3) AS lo_ms, round(node.hi * 1e3, 3) AS hi_ms,
       verdict.text AS verdict
FROM node
JOIN name ON name.id = node.name AND name.unit = 's'
LEFT JOIN transit ON transit.run = node.run AND transit.iteration = node.iteration AND transit.node = node.node
LEFT JOIN verdict ON verdict.id = transit.verdict;

CREATE VIEW stage_statistics AS
SELECT rollup.run, name.text AS name, name.unit, rollup.count, rollup.mean,
       rollup.m2 / nullif(rollup.count - 1, 0) AS variance, rollup.min, rollup.max
FROM rollup
JOIN name ON name.id = rollup.name
WHERE rollup.resolution_s = 0 AND rollup.quantity = 0;

CREATE VIEW run_list AS
SELECT run.number, host.name AS host, pipeline.name AS pipeline, run.placement, run.peer, run.model,
       datetime(run.started_ns / 1000000000, 'unixepoch') AS started_utc,
       datetime(run.ended_ns / 1000000000, 'unixepoch') AS ended_utc,
       run.end_reason, run.ok, run.failed, run.lost, run.timeout, run.warm_up
FROM run
JOIN pipeline ON pipeline.id = run.pipeline
JOIN host ON host.id = pipeline.host
ORDER BY run.number DESC;
