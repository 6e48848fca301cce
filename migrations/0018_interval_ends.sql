-- What a row of `rollup` summarizes. Statistics of whole runs also have the ends of the intervals of delays and throughputs, from which the
-- interval of a median follows. Runs of earlier versions have them after `peernetd rebuild-rollups`, as long as their nodes are stored.
CREATE TABLE quantity (id INTEGER PRIMARY KEY, text TEXT NOT NULL) STRICT;
INSERT INTO quantity VALUES (0, 'value'), (1, 'half-width'), (2, 'lower-end'), (3, 'upper-end');
