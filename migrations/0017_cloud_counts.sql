-- What the cloud of a connection counted at its end, as far as it told its edge: totals since the connection was opened, a second
-- or two older than those of the edge. `cloud_received` is what `sent` left the edge as. NULL: the cloud told nothing, or cannot know.
-- The cloud counts no late messages: it gives no request up.
ALTER TABLE connection_sample ADD COLUMN cloud_received_bytes INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_received_messages INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_received_datagrams INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_received_lost INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_received_duplicated INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_received_reordered INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_received_retransmitted INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_sent_bytes INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_sent_messages INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_sent_datagrams INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_sent_lost INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_sent_duplicated INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_sent_reordered INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_sent_retransmitted INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_malformed_messages INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_lost_messages INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_round_trip_min_ns INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_round_trip_ns INTEGER;
ALTER TABLE connection_sample ADD COLUMN cloud_round_trip_variation_ns INTEGER;

-- For people.
DROP VIEW connection_total;
CREATE VIEW connection_total AS
SELECT edge.name AS edge, coalesce(cloud.name, link.cloud_name) AS cloud, link.network, sample.pipeline,
       strftime('%Y-%m-%d %H:%M:%f', sample.at_ns / 1e9, 'unixepoch') AS at_utc,
       sample.local_address, sample.interface, sample.interface_type, sample.mtu_bytes,
       sample.sent_bytes, sample.sent_messages, sample.sent_datagrams, sample.sent_retransmitted,
       sample.received_bytes, sample.received_messages, sample.received_datagrams, sample.received_reordered,
       round(sample.round_trip_min_ns / 1e6, 3) AS round_trip_min_ms, round(sample.round_trip_ns / 1e6, 3) AS round_trip_ms,
       sample.cloud_received_bytes, sample.cloud_received_messages, sample.cloud_received_datagrams,
       sample.cloud_received_reordered,
       sample.cloud_sent_bytes, sample.cloud_sent_messages, sample.cloud_sent_datagrams, sample.cloud_sent_retransmitted,
       round(sample.cloud_round_trip_min_ns / 1e6, 3) AS cloud_round_trip_min_ms,
       round(sample.cloud_round_trip_ns / 1e6, 3) AS cloud_round_trip_ms
FROM connection_sample AS sample
JOIN link ON link.id = sample.link
JOIN host AS edge ON edge.id = link.edge
JOIN host AS cloud ON cloud.id = link.cloud;
