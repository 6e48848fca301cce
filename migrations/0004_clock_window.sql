-- The windows of each link in the order in which they came. Their numbers are random, and times do not tell the order: a
-- clock that was set back shows the same seconds in the window before the step and in the one after it. What the later
-- one says of them counts.
CREATE TABLE clock_window (
    id       INTEGER PRIMARY KEY,  -- rises with the order of arrival
    link     INTEGER NOT NULL,     -- link.id
    window   INTEGER NOT NULL,     -- clock_sample.window
    first_ns INTEGER NOT NULL,     -- clock_sample.at_ns, the smallest
    last_ns  INTEGER NOT NULL,     -- the greatest
    UNIQUE (link, window)
) STRICT;

-- Of those that were there before, the order in which they begin.
INSERT INTO clock_window (link, window, first_ns, last_ns)
SELECT link, window, min(at_ns), max(at_ns) FROM clock_sample GROUP BY link, window ORDER BY min(at_ns), max(at_ns);
