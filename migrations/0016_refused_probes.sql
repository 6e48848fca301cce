-- Packets of a second that arrived and were refused as answers to probes, and probes that could not be sent. What is stored so far
-- counted none.
ALTER TABLE clock_sample ADD COLUMN probes_refused INTEGER NOT NULL DEFAULT 0;

-- For people.
DROP VIEW clock_ms;
CREATE VIEW clock_ms AS
SELECT edge.name AS edge, coalesce(cloud.name, link.cloud_name) AS cloud, link.network,
       strftime('%Y-%m-%d %H:%M:%f', sample.at_ns / 1e9, 'unixepoch') AS at_utc,
       round(sample.offset_ns / 1e6, 3) AS offset_ms,
       round(sample.offset_lo_ns / 1e6, 3) AS lo_ms, round(sample.offset_hi_ns / 1e6, 3) AS hi_ms,
       round(sample.skew_ppm, 3) AS skew_ppm, source.text AS source, verdict.text AS verdict,
       round(sample.round_trip_min_ns / 1e6, 3) AS round_trip_ms,
       sample.probes_sent AS probes, sample.probes_lost AS lost, sample.probes_refused,
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
