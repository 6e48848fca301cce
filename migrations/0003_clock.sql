-- The relation between two hosts' wall clocks, second by second, so that the delays of a past run can be computed
-- again with what was learnt after it. In milliseconds, for people:
--
--   SELECT * FROM clock_ms WHERE edge = 'robot' ORDER BY at_utc DESC LIMIT 60;

CREATE TABLE link (
    id         INTEGER PRIMARY KEY,
    edge       INTEGER NOT NULL REFERENCES host (id),
    cloud      INTEGER NOT NULL REFERENCES host (id),
    cloud_name TEXT NOT NULL,  -- as the edge called it last; host.name counts more where the cloud reports here too
    UNIQUE (edge, cloud)
) STRICT;

-- No foreign key, as in all tables that grow without end. The offset is cloud minus edge. Stamps named _sent_ns and
-- _returned_ns are the edge's wall clock, _received_ns and _replied_ns the cloud's. An interval whose lower end was
-- above its upper one is stored as NULL, and so is what is no number.
--
-- The window is part of the key: a clock that was set back shows a second twice, and both are true.
CREATE TABLE clock_sample (
    link                 INTEGER NOT NULL,  -- link.id
    at_ns                INTEGER NOT NULL,  -- the end of the second, on the edge's wall clock
    window               INTEGER NOT NULL,  -- a random number that changes when a clock is stepped: 64 bits
    max_drift_ppm        REAL,              -- the limit of drift that the bounds rest on

    -- The exchange of this second that bounds the offset best from above.
    upper_sent_ns        INTEGER,
    upper_received_ns    INTEGER,
    upper_replied_ns     INTEGER,
    upper_returned_ns    INTEGER,
    upper_uncertainty_ns INTEGER,
    -- The one that bounds it best from below.
    lower_sent_ns        INTEGER,
    lower_received_ns    INTEGER,
    lower_replied_ns     INTEGER,
    lower_returned_ns    INTEGER,
    lower_uncertainty_ns INTEGER,

    -- What was known at the end of the second; all NULL while nothing was.
    offset_ns            INTEGER,
    offset_lo_ns         INTEGER,
    offset_hi_ns         INTEGER,
    offset_source        INTEGER,           -- source.id
    offset_verdict       INTEGER,           -- verdict.id
    offset_sources       TEXT,              -- JSON: [[source, lo_ns, hi_ns], …]; NULL when there is the one above alone
    skew_ppm             REAL,
    exchanges            INTEGER,           -- that the window was given
    age_ns               INTEGER,           -- of the newest of them

    -- Probes of this second.
    probes_sent          INTEGER NOT NULL,
    probes_answered      INTEGER NOT NULL,
    probes_lost          INTEGER NOT NULL,
    round_trip_min_ns    INTEGER,
    round_trip_median_ns INTEGER,

    -- Delays of data that were judged in this second: how many, the median with its own bounds, the worst verdict
    -- that a twentieth of them were given.
    up_count             INTEGER,
    up_ns                INTEGER,
    up_lo_ns             INTEGER,
    up_hi_ns             INTEGER,
    up_bits_per_second   REAL,
    up_verdict           INTEGER,           -- verdict.id
    down_count           INTEGER,
    down_ns              INTEGER,
    down_lo_ns           INTEGER,
    down_hi_ns           INTEGER,
    down_bits_per_second REAL,
    down_verdict         INTEGER,           -- verdict.id

    -- What became of all exchanges since the relation was made.
    taken                INTEGER NOT NULL,
    impossible           INTEGER NOT NULL,  -- refused: no two clocks can show this
    outliers             INTEGER NOT NULL,  -- refused: against all others
    stepped              INTEGER NOT NULL,  -- refused: a clock was stepped on the way
    restarts             INTEGER NOT NULL,  -- windows begun after a step
    PRIMARY KEY (link, at_ns, window)
) STRICT, WITHOUT ROWID;

-- For people.
CREATE VIEW clock_ms AS
SELECT edge.name AS edge, coalesce(cloud.name, link.cloud_name) AS cloud,
       strftime('%Y-%m-%d %H:%M:%f', sample.at_ns / 1e9, 'unixepoch') AS at_utc,
       round(sample.offset_ns / 1e6, 3) AS offset_ms,
       round(sample.offset_lo_ns / 1e6, 3) AS lo_ms, round(sample.offset_hi_ns / 1e6, 3) AS hi_ms,
       round(sample.skew_ppm, 3) AS skew_ppm, source.text AS source, verdict.text AS verdict,
       round(sample.round_trip_min_ns / 1e6, 3) AS round_trip_ms,
       sample.probes_sent AS probes, sample.probes_lost AS lost,
       round(sample.up_ns / 1e6, 3) AS up_ms, round(sample.down_ns / 1e6, 3) AS down_ms,
       sample.impossible + sample.outliers + sample.stepped AS refused
FROM clock_sample AS sample
JOIN link ON link.id = sample.link
JOIN host AS edge ON edge.id = link.edge
JOIN host AS cloud ON cloud.id = link.cloud
LEFT JOIN source ON source.id = sample.offset_source
LEFT JOIN verdict ON verdict.id = sample.offset_verdict;
