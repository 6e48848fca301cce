-- What was sent and received on the connections of a link: totals since a connection was opened, by the account of its edge,
-- once a minute and when the connection had ended.
--
--   SELECT * FROM connection_total WHERE edge = 'robot' ORDER BY at_utc DESC LIMIT 10;
--
-- No foreign key, as in all tables that grow without end. NULL is what the edge cannot know, never 0.
CREATE TABLE connection_sample (
    link                   INTEGER NOT NULL,  -- link.id
    at_ns                  INTEGER NOT NULL,  -- on the edge's wall clock
    pipeline               TEXT NOT NULL,
    network                TEXT NOT NULL,
    local_address          TEXT,              -- the edge's end; another one is another connection
    remote_address         TEXT,
    interface              TEXT,              -- of the edge
    interface_type         TEXT,
    mtu_bytes              INTEGER,
    sent_bytes             INTEGER NOT NULL,
    sent_messages          INTEGER NOT NULL,
    sent_datagrams         INTEGER,
    sent_lost              INTEGER,           -- datagrams, as all that follows
    sent_duplicated        INTEGER,
    sent_reordered         INTEGER,
    sent_retransmitted     INTEGER,
    received_bytes         INTEGER NOT NULL,
    received_messages      INTEGER NOT NULL,
    received_datagrams     INTEGER,
    received_lost          INTEGER,
    received_duplicated    INTEGER,
    received_reordered     INTEGER,
    received_retransmitted INTEGER,
    malformed_messages     INTEGER NOT NULL,
    late_messages          INTEGER NOT NULL,
    lost_messages          INTEGER NOT NULL,
    -- Round trip of the transport's own packets.
    round_trip_min_ns      INTEGER,
    round_trip_ns          INTEGER,
    round_trip_variation_ns INTEGER,
    PRIMARY KEY (link, at_ns, pipeline, network)
) STRICT, WITHOUT ROWID;

-- For people.
CREATE VIEW connection_total AS
SELECT edge.name AS edge, coalesce(cloud.name, link.cloud_name) AS cloud, sample.pipeline, sample.network,
       strftime('%Y-%m-%d %H:%M:%f', sample.at_ns / 1e9, 'unixepoch') AS at_utc,
       sample.local_address, sample.interface, sample.interface_type, sample.mtu_bytes,
       sample.sent_bytes, sample.sent_messages, sample.sent_datagrams, sample.sent_retransmitted,
       sample.received_bytes, sample.received_messages, sample.received_datagrams, sample.received_reordered,
       round(sample.round_trip_min_ns / 1e6, 3) AS round_trip_min_ms, round(sample.round_trip_ns / 1e6, 3) AS round_trip_ms
FROM connection_sample AS sample
JOIN link ON link.id = sample.link
JOIN host AS edge ON edge.id = link.edge
JOIN host AS cloud ON cloud.id = link.cloud;
