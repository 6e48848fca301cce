-- The free-running clocks (CLOCK_MONOTONIC_RAW) of both hosts, by which one-way delays are judged: no time daemon steps or slews them.
-- They count from the start of their machine, so that times of different starts overlap. NULL: recorded before 0.3.0, or an end
-- that stamps by its wall clock alone. Where the cloud has no raw stamps, its wall clock stands in their place (clocks = 1).
ALTER TABLE transit ADD COLUMN sent_raw_ns INTEGER;      -- the sender's raw clock
ALTER TABLE transit ADD COLUMN received_raw_ns INTEGER;  -- the receiver's raw clock

-- The clocks that the stamps of a sample's exchanges are of, edge and cloud: 0 raw and raw, 1 raw and wall, 2 or NULL wall and wall.
ALTER TABLE clock_sample ADD COLUMN clocks INTEGER;
ALTER TABLE clock_sample ADD COLUMN at_raw_ns INTEGER;           -- the edge's raw clock at at_ns
ALTER TABLE clock_sample ADD COLUMN proven_skew_min_ppm REAL;    -- rates between the two clocks that the exchanges allow
ALTER TABLE clock_sample ADD COLUMN proven_skew_max_ppm REAL;
ALTER TABLE clock_sample ADD COLUMN grown_window_ns INTEGER;     -- age of the oldest exchange that counts; NULL: within the configured window
CREATE INDEX clock_sample_by_raw ON clock_sample (link, window, at_raw_ns) WHERE at_raw_ns IS NOT NULL;

-- What the bounds of a window rest on beside its exchanges, by its newest sample. NULL: not told.
ALTER TABLE clock_window ADD COLUMN clocks INTEGER;                       -- as clock_sample.clocks
ALTER TABLE clock_window ADD COLUMN max_drift_ppm REAL;                   -- the limit of drift
ALTER TABLE clock_window ADD COLUMN max_drift_change_ppm_per_s REAL;      -- the limit of how fast the drift changes
ALTER TABLE clock_window ADD COLUMN claims_trusted INTEGER;               -- 1: claims of time daemons may narrow the interval
ALTER TABLE clock_window ADD COLUMN probes_authenticated INTEGER;         -- 1: all probes were
UPDATE clock_window SET max_drift_ppm = (SELECT sample.max_drift_ppm FROM clock_sample AS sample
    WHERE sample.link = clock_window.link AND sample.at_ns = clock_window.last_ns AND sample.window = clock_window.window);

-- For people.
DROP VIEW clock_ms;
CREATE VIEW clock_ms AS
SELECT edge.name AS edge, coalesce(cloud.name, link.cloud_name) AS cloud, link.network,
       strftime('%Y-%m-%d %H:%M:%f', sample.at_ns / 1e9, 'unixepoch') AS at_utc,
       round(sample.offset_ns / 1e6, 3) AS offset_ms,
       round(sample.offset_lo_ns / 1e6, 3) AS lo_ms, round(sample.offset_hi_ns / 1e6, 3) AS hi_ms,
       round(sample.skew_ppm, 3) AS skew_ppm, source.text AS source, verdict.text AS verdict,
       round(sample.round_trip_min_ns / 1e6, 3) AS round_trip_ms,
       sample.probes_sent AS probes, sample.probes_lost AS lost,
       round(sample.up_ns / 1e6, 3) AS up_ms, round(sample.down_ns / 1e6, 3) AS down_ms,
       sample.impossible + sample.outliers + sample.stepped AS refused,
       CASE sample.clocks WHEN 0 THEN 'raw' WHEN 1 THEN 'raw-to-wall' ELSE 'wall' END AS clocks,
       round(sample.proven_skew_min_ppm, 3) AS proven_skew_min_ppm, round(sample.proven_skew_max_ppm, 3) AS proven_skew_max_ppm
FROM clock_sample AS sample
JOIN link ON link.id = sample.link
JOIN host AS edge ON edge.id = link.edge
JOIN host AS cloud ON cloud.id = link.cloud
LEFT JOIN source ON source.id = sample.offset_source
LEFT JOIN verdict ON verdict.id = sample.offset_verdict;
