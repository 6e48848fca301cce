-- A link is an edge and a cloud over one network: two hosts that use two networks have two links. What is stored so far went
-- over zmq-tcp, the only network there was. A unique key cannot be changed: the table is made anew, with the same ids.
DROP VIEW clock_ms;
CREATE TABLE link_of_network (
    id                INTEGER PRIMARY KEY,
    edge              INTEGER NOT NULL REFERENCES host (id),
    cloud             INTEGER NOT NULL REFERENCES host (id),
    network           TEXT NOT NULL,     -- as run.network
    cloud_name        TEXT NOT NULL,     -- as the edge called it last; host.name counts more where the cloud reports here too
    arriving_from_s   INTEGER,           -- storage clock, seconds
    arriving_first_ns INTEGER,           -- clock_sample.at_ns
    arriving_last_ns  INTEGER,
    UNIQUE (edge, cloud, network)
) STRICT;
INSERT INTO link_of_network
SELECT id, edge, cloud, 'zmq-tcp', cloud_name, arriving_from_s, arriving_first_ns, arriving_last_ns FROM link;
DROP TABLE link;
ALTER TABLE link_of_network RENAME TO link;
CREATE INDEX link_arriving ON link (arriving_from_s) WHERE arriving_from_s IS NOT NULL;

-- For people.
CREATE VIEW clock_ms AS
SELECT edge.name AS edge, coalesce(cloud.name, link.cloud_name) AS cloud, link.network,
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
