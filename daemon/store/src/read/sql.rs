//! The statements of all queries. Parameters are numbered, and the comment on each statement lists them.

macro_rules! statements {
    ($($(#[$doc:meta])* $name:ident = $text:expr;)*) => {
        $($(#[$doc])* pub(crate) const $name: &str = $text;)*

        /// All statements by name. A test checks their query plans.
        #[cfg(test)]
        pub(crate) const ALL: &[(&str, &str)] = &[$((stringify!($name), $text)),*];
    };
}

macro_rules! run_columns {
    () => {
        "SELECT run.number, run.uuid, host.uuid AS host_uuid, host.name AS host_name, pipeline.name AS pipeline, \
         run.placement, run.peer, run.network, run.address, run.model, run.device, run.started_ns, run.ended_ns, \
         run.end_reason, run.last_iteration_ns, run.warm_up, run.ok, run.failed, run.lost, run.timeout, \
         run.facts, run.configuration, run.version, run.pinned, run.nodes_from, run.experiment, run.conditions, \
         run.skipped_starts \
         FROM run JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host "
    };
}

macro_rules! rollup_columns {
    () => {
        "SELECT rollup.run, name.text, name.unit, rollup.name, rollup.quantity, rollup.bucket_s, rollup.count, rollup.mean, \
         rollup.m2, rollup.min, rollup.max, rollup.sketch \
         FROM rollup JOIN name ON name.id = rollup.name "
    };
}

macro_rules! clock_columns {
    () => {
        clock_columns!("", "")
    };
    // The arguments are texts before and after each column of a throughput.
    ($before:literal, $after:literal) => {
        concat!(
            "at_ns, window, offset_ns, offset_lo_ns, offset_hi_ns, offset_source, offset_verdict, offset_sources, \
             skew_ppm, exchanges, age_ns, probes_sent, probes_answered, probes_lost, probes_refused, round_trip_min_ns, \
             round_trip_median_ns, up_count, up_ns, up_lo_ns, up_hi_ns, ",
            $before,
            "up_bits_per_second",
            $after,
            ", up_verdict, down_count, down_ns, down_lo_ns, down_hi_ns, ",
            $before,
            "down_bits_per_second",
            $after,
            ", down_verdict, clocks, proven_skew_min_ppm, proven_skew_max_ppm, grown_window_ns"
        )
    };
}

macro_rules! exchange_columns {
    () => {
        "at_ns, max_drift_ppm, upper_sent_ns, upper_received_ns, upper_replied_ns, upper_returned_ns, upper_uncertainty_ns, \
         lower_sent_ns, lower_received_ns, lower_replied_ns, lower_returned_ns, lower_uncertainty_ns, \
         offset_lo_ns, offset_hi_ns, offset_source, offset_sources, \
         (SELECT max_drift_change_ppm_per_s FROM clock_window WHERE link = ?1 AND window = ?2) AS max_drift_change_ppm_per_s"
    };
}

macro_rules! iteration_columns {
    () => {
        "SELECT number, episode, step, warm_up, outcome, reason, started_ns, total FROM iteration "
    };
    ($index:literal) => {
        concat!(iteration_columns!(), "INDEXED BY ", $index, " ")
    };
}

statements! {
    /// Runs, newest first: ?1 number below which runs are selected, ?2 limit.
    RUNS = concat!(run_columns!(), "WHERE run.number < ?1 ORDER BY run.number DESC LIMIT ?2");
    /// Runs of a pipeline or a host, newest first: ?1 number below which runs are selected, ?2 limit, ?3 name of
    /// the pipeline or NULL, ?4 random id of the host or NULL.
    RUNS_FILTERED = concat!(run_columns!(),
        "WHERE run.number < ?1 AND run.pipeline IN (SELECT pipeline.id FROM pipeline JOIN host ON host.id = pipeline.host \
         WHERE (?3 IS NULL OR pipeline.name = ?3) AND (?4 IS NULL OR host.uuid = ?4)) \
         ORDER BY run.number DESC LIMIT ?2");
    /// One run: ?1 number.
    RUN = concat!(run_columns!(), "WHERE run.number = ?1");
    /// The first runs of an experiment, oldest first: ?1 id of the experiment, ?2 limit.
    RUNS_OF_EXPERIMENT = concat!(run_columns!(),
        "WHERE run.experiment IS NOT NULL AND run.experiment ->> 'id' = ?1 ORDER BY run.number LIMIT ?2");
    /// Experiments, the one with the newest run first: ?1 limit.
    EXPERIMENTS = "SELECT max(run.number) AS newest, min(run.number) AS oldest, run.experiment ->> 'name' AS name, \
                   run.experiment ->> 'id' AS id, count(*) AS runs, sum(run.ended_ns IS NULL) AS open, \
                   min(run.started_ns) AS started_ns \
                   FROM run WHERE run.experiment IS NOT NULL GROUP BY run.experiment ->> 'id' \
                   ORDER BY newest DESC LIMIT ?1";
    /// The first 1,000 gaps of a run: ?1 run.
    GAPS = "SELECT from_ns, to_ns, count, reason, 1 FROM gap WHERE run = ?1 ORDER BY from_ns LIMIT 1000";
    /// The later gaps of a run, combined by reason. Gaps of unknown size, whose count is 0, are not combined with gaps
    /// of known size. ?1 run.
    FURTHER_GAPS = "SELECT min(from_ns), max(to_ns), sum(count), reason, count(*) FROM \
        (SELECT from_ns, to_ns, count, reason FROM gap WHERE run = ?1 ORDER BY from_ns LIMIT -1 OFFSET 1000) \
        GROUP BY reason, count = 0 ORDER BY min(from_ns)";
    /// Summaries of one name over whole runs: ?1 the runs, a JSON array, ?2 name.
    ROLLUPS_OF_NAME = concat!(rollup_columns!(),
        "WHERE rollup.run IN (SELECT value FROM json_each(?1)) AND rollup.resolution_s = 0 AND rollup.bucket_s = 0 AND rollup.quantity = 0 \
         AND rollup.name IN (SELECT id FROM name WHERE text = ?2)");
    /// Summaries of all names over whole runs: ?1 the runs, a JSON array.
    ROLLUPS = concat!(rollup_columns!(),
        "WHERE rollup.run IN (SELECT value FROM json_each(?1)) AND rollup.resolution_s = 0");
    /// The rows of some names: ?1 their texts, a JSON array.
    NAMES = "SELECT id, text, unit FROM name WHERE text IN (SELECT value FROM json_each(?1))";
    /// Summaries of some names over time: ?1 run, ?2 resolution, ?3 the names' ids, a JSON array.
    ROLLUPS_OVER_TIME = "SELECT run, resolution_s, bucket_s, name, quantity, count, mean, m2, min, max, sketch \
                         FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND quantity = 0 \
                         AND name IN (SELECT value FROM json_each(?3)) ORDER BY bucket_s";
    /// Summaries of some names within a period: ?1 run, ?2 resolution, ?3 the names' ids, a JSON array, ?4 start of the
    /// first bucket, ?5 start of the bucket after the last bucket.
    ROLLUPS_WITHIN = "SELECT run, resolution_s, bucket_s, name, quantity, count, mean, m2, min, max, sketch \
                      FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s >= ?4 AND bucket_s < ?5 AND quantity = 0 \
                      AND name IN (SELECT value FROM json_each(?3))";
    /// Counts and sums of some names over time: ?1 run, ?2 resolution, ?3 the names' ids, a JSON array, ?4 width of a
    /// point in seconds, a multiple of the resolution.
    SUMS_OVER_TIME = "SELECT name, bucket_s / ?4 AS point, sum(count), sum(count * mean) \
                      FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND quantity = 0 \
                      AND name IN (SELECT value FROM json_each(?3)) GROUP BY point, name ORDER BY point, name";
    /// Numbers of delays per verdict: ?1 the runs, a JSON array.
    VERDICTS = "SELECT verdict_count.run, name.text, verdict_count.verdict, verdict_count.count FROM verdict_count \
                JOIN name ON name.id = verdict_count.name \
                WHERE verdict_count.run IN (SELECT value FROM json_each(?1)) ORDER BY verdict_count.verdict";
    /// For each resolution: its first and last bucket, and whether buckets were deleted. ?1 run, ?2 the resolutions, a
    /// JSON array.
    WIDTH_EXTENTS = "SELECT width.value, \
               (SELECT min(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = width.value), \
               (SELECT max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = width.value), \
               EXISTS (SELECT 1 FROM trimmed WHERE run = ?1 AND kind = width.value) \
               FROM json_each(?2) AS width";
    /// The slowest successful iterations after the warm-up: ?1 run, ?2 limit.
    SLOWEST = concat!(iteration_columns!(),
        "WHERE run = ?1 AND warm_up = 0 AND outcome = 0 AND total IS NOT NULL ORDER BY total DESC, number DESC LIMIT ?2");
    /// A page of iterations: ?1 run, ?2 number above which iterations are selected, ?3 limit.
    ITERATIONS = concat!(iteration_columns!(), "WHERE run = ?1 AND number > ?2 ORDER BY number LIMIT ?3");
    /// A page of failed iterations, which are the rows of the index `iteration_without_answer`. Parameters as in
    /// `ITERATIONS`.
    FAILED_ITERATIONS = concat!(iteration_columns!("iteration_without_answer"),
        "WHERE run = ?1 AND number > ?2 AND outcome <> 0 ORDER BY number LIMIT ?3");
    /// The iteration with the largest number: ?1 run.
    // Here and below, the condition `number > 0` excludes no row. It makes the query plan show that SQLite searches by
    // number, as the test of query plans requires.
    LAST_ITERATION = concat!(iteration_columns!(), "WHERE run = ?1 AND number > 0 ORDER BY number DESC LIMIT 1");
    /// For each of some numbers, the number of the first stored iteration at or after it. ?1 run, ?2 numbers, a JSON
    /// array.
    FIRST_STORED = "SELECT (SELECT number FROM iteration WHERE run = ?1 AND number >= start.value \
                    ORDER BY number LIMIT 1) FROM json_each(?2) AS start";
    /// For each of some numbers, the number of the first iteration at or after it that is not warm-up. `+warm_up` makes
    /// SQLite find iterations by number and not by the index that contains `warm_up`. ?1 run, ?2 numbers, a JSON array,
    /// ?3 how many numbers after each number are searched.
    WARM_UP_ENDS = "SELECT (SELECT number FROM iteration \
                    WHERE run = ?1 AND number BETWEEN start.value AND start.value + ?3 AND +warm_up = 0 \
                    ORDER BY number LIMIT 1) FROM json_each(?2) AS start";
    /// The last iteration that is not warm-up: ?1 run, ?2 and ?3 the first and the last number that is searched.
    LAST_MEASURED = concat!(iteration_columns!(),
        "WHERE run = ?1 AND number BETWEEN ?2 AND ?3 AND +warm_up = 0 ORDER BY number DESC LIMIT 1");
    /// The first successful iteration after the warm-up: ?1 run, ?2 the last number that is searched.
    FIRST_IN_STATISTICS = concat!(iteration_columns!(),
        "WHERE run = ?1 AND number BETWEEN 1 AND ?2 AND +warm_up = 0 AND +outcome = 0 ORDER BY number LIMIT 1");
    /// The last successful iteration after the warm-up: ?1 run, ?2 how many of the last numbers are searched.
    LAST_IN_STATISTICS = concat!(iteration_columns!(),
        "WHERE run = ?1 AND number > (SELECT max(number) FROM iteration WHERE run = ?1 AND number > 0) - ?2 \
         AND +warm_up = 0 AND +outcome = 0 ORDER BY number DESC LIMIT 1");
    /// The number of the first iteration that started at a time or later, or one more than the last number if there is
    /// no such iteration. The iteration is found by bisection, because no index contains the starts. ?1 run, ?2 time.
    FIRST_NUMBER_SINCE = "WITH RECURSIVE search(low, high) AS ( \
                          SELECT 0, (SELECT max(number) FROM iteration WHERE run = ?1 AND number > 0) + 1 \
                          UNION ALL SELECT \
                          iif((SELECT started_ns FROM iteration WHERE run = ?1 AND number >= (low + high) / 2 \
                          ORDER BY number LIMIT 1) < ?2, (low + high) / 2, low), \
                          iif((SELECT started_ns FROM iteration WHERE run = ?1 AND number >= (low + high) / 2 \
                          ORDER BY number LIMIT 1) < ?2, high, (low + high) / 2) \
                          FROM search WHERE high - low > 1) \
                          SELECT max(high) FROM search WHERE high - low <= 1";
    /// Totals of the successful iterations after the warm-up: ?1 run, ?2 and ?3 first and last number.
    TOTALS_IN_STATISTICS = "SELECT total FROM iteration WHERE run = ?1 AND number BETWEEN ?2 AND ?3 AND +warm_up = 0 AND +outcome = 0";
    /// Number of failed iterations, and how many of them are warm-up, both counted up to a limit: ?1 run, ?2 limit.
    FAILED_COUNT = "SELECT count(*), count(*) FILTER (WHERE warm_up <> 0) \
                            FROM (SELECT warm_up FROM iteration INDEXED BY iteration_without_answer \
                            WHERE run = ?1 AND number > 0 AND outcome <> 0 LIMIT ?2)";
    /// The first number of a failed iteration in each part of a run: ?1 run, ?2 the parts' first and last numbers, a
    /// JSON array of pairs.
    FIRST_FAILED_OF_PARTS = "SELECT (SELECT number FROM iteration INDEXED BY iteration_without_answer \
                            WHERE run = ?1 AND number BETWEEN part.value ->> 0 AND part.value ->> 1 AND outcome <> 0 \
                            ORDER BY number LIMIT 1) FROM json_each(?2) AS part";
    /// One iteration: ?1 run, ?2 number.
    ITERATION = concat!(iteration_columns!(), "WHERE run = ?1 AND number = ?2");
    /// Durations of the nodes of some iterations: ?1 run, ?2 the iterations' numbers, a JSON array.
    DURATIONS = "SELECT node.iteration, node.node, node.parent, name.text, node.value \
                 FROM node CROSS JOIN name ON name.id = node.name \
                 WHERE node.run = ?1 AND node.iteration IN (SELECT value FROM json_each(?2)) \
                 AND node.value IS NOT NULL AND name.unit = 's' ORDER BY node.iteration, node.node";
    /// The nodes with one of two names, and the nodes `sensing`, in iterations that statistics include. Iterations are
    /// found by their numbers: with the index that contains `warm_up` and `outcome`, SQLite would read all iterations
    /// of the run. ?1 run, ?2 numbers, a JSON array, ?3 and ?4 the names.
    PAIRS = "SELECT node.iteration, node.node, node.parent, node.value, \
             (SELECT text FROM name WHERE id = node.name) AS text \
             FROM iteration CROSS JOIN node ON node.run = iteration.run AND node.iteration = iteration.number \
             WHERE iteration.run = ?1 AND iteration.number IN (SELECT value FROM json_each(?2)) \
             AND +iteration.warm_up = 0 AND +iteration.outcome = 0 \
             AND node.name IN (SELECT id FROM name WHERE text IN (?3, ?4, 'sensing')) \
             ORDER BY iteration.number, node.node";
    /// Judged one-way delays of some iterations. The cloud is the tree's second host. ?1 run, ?2 the iterations'
    /// numbers, a JSON array.
    DELAYS = "SELECT transit.iteration, name.text, node.value, node.lo, node.hi, transit.raw_ns, transit.source, \
              transit.verdict, transit.sent_ns, transit.received_ns, \
              (SELECT anchor.host FROM anchor WHERE anchor.run = ?1 AND anchor.iteration = transit.iteration \
               AND anchor.position = 1) AS cloud FROM transit \
              CROSS JOIN node ON node.run = transit.run AND node.iteration = transit.iteration AND node.node = transit.node \
              CROSS JOIN name ON name.id = node.name \
              WHERE transit.run = ?1 AND transit.iteration IN (SELECT value FROM json_each(?2)) \
              AND transit.raw_ns IS NOT NULL AND transit.source IS NOT NULL AND transit.verdict IS NOT NULL \
              ORDER BY transit.iteration, transit.node";
    /// Iterations by number: ?1 run, ?2 numbers, a JSON array.
    ITERATIONS_BY_NUMBER = concat!(iteration_columns!(),
        "WHERE run = ?1 AND number IN (SELECT value FROM json_each(?2)) ORDER BY number");
    /// The number of the last iteration of a page: ?1 run, ?2 number after which the page begins, ?3 number of
    /// iterations of a page.
    LAST_OF_PAGE = "SELECT max(number) FROM (SELECT number FROM iteration WHERE run = ?1 AND number > ?2 \
                    ORDER BY number LIMIT ?3)";
    /// The first iteration of each shape of tree among the iterations of a page: ?1 run, ?2 number after which the page
    /// begins, ?3 last number of the page, ?4 limit.
    SHAPES = "SELECT min(iteration) AS first FROM (SELECT iteration, \
              group_concat(name || '<' || parent || iif(value IS NULL, '?', '')) AS shape \
              FROM node WHERE run = ?1 AND iteration > ?2 AND iteration <= ?3 GROUP BY iteration) \
              GROUP BY shape ORDER BY first LIMIT ?4";
    /// The nodes of the trees of some iterations: ?1 run, ?2 the iterations' numbers, a JSON array.
    NODES = "SELECT node.iteration, node.node, node.parent, node.host, node.start_ns, node.value, node.lo, node.hi, \
             name.text, name.kind, name.custom, name.unit FROM node CROSS JOIN name ON name.id = node.name \
             WHERE node.run = ?1 AND node.iteration IN (SELECT value FROM json_each(?2)) \
             ORDER BY node.iteration, node.node";
    /// The transits in the trees of some iterations. Parameters as in `NODES`.
    TRANSITS = "SELECT iteration, node, sent_ns, received_ns, raw_ns, source, verdict, sent_raw_ns, received_raw_ns FROM transit \
                WHERE run = ?1 AND iteration IN (SELECT value FROM json_each(?2)) ORDER BY iteration, node";
    /// The edge of a run, and the name of its cloud: ?1 run.
    TREE_HOSTS = "SELECT host.uuid, host.name, run.peer FROM run JOIN pipeline ON pipeline.id = run.pipeline \
            JOIN host ON host.id = pipeline.host WHERE run.number = ?1";
    /// The anchors in the trees of some iterations. The table has no anchors of the edge, because the start of the
    /// iteration takes their place. Parameters as in `NODES`.
    ANCHORS = "SELECT anchor.iteration, host.uuid, host.name, anchor.wall_ns FROM anchor \
               CROSS JOIN host ON host.id = anchor.host \
               WHERE anchor.run = ?1 AND anchor.iteration IN (SELECT value FROM json_each(?2)) \
               ORDER BY anchor.iteration, anchor.position";
    /// Number of successful iterations that are slower than a total, counted up to 1,000: ?1 run, ?2 total.
    SLOWER_COUNT = "SELECT count(*) FROM (SELECT 1 FROM iteration WHERE run = ?1 AND warm_up = 0 AND outcome = 0 \
              AND total IS NOT NULL AND total > ?2 LIMIT 1000)";
    /// The next slower iteration, in the order of `SLOWEST`: ?1 run, ?2 total and ?3 number of the iteration.
    NEXT_SLOWER = "SELECT number FROM iteration WHERE run = ?1 AND warm_up = 0 AND outcome = 0 \
                  AND (total, number) > (?2, ?3) ORDER BY total, number LIMIT 1";
    /// The next faster iteration, in the order of `SLOWEST`. Parameters as in `NEXT_SLOWER`.
    NEXT_FASTER = "SELECT number FROM iteration WHERE run = ?1 AND warm_up = 0 AND outcome = 0 \
                  AND (total, number) < (?2, ?3) ORDER BY total DESC, number DESC LIMIT 1";
    /// The number of the previous stored iteration: ?1 run, ?2 number.
    PREVIOUS = "SELECT max(number) FROM iteration WHERE run = ?1 AND number < ?2";
    /// The number of the next stored iteration: ?1 run, ?2 number.
    NEXT = "SELECT min(number) FROM iteration WHERE run = ?1 AND number > ?2";
    /// Incidents, newest first: ?1 limit, ?2 id of the last incident of the previous page or NULL, ?3 kind or NULL, ?4
    /// name of a host or NULL.
    INCIDENTS = "SELECT incident.id, incident.at_ns, incident.kind, host.uuid AS host, host.name AS host_name, \
                 incident.pipeline, incident.run, coalesce(peer.name, peer.uuid) AS peer, incident.text \
                 FROM incident LEFT JOIN host ON host.id = incident.host LEFT JOIN host AS peer ON peer.id = incident.peer \
                 WHERE (incident.at_ns, incident.id) < \
                   (coalesce((SELECT at_ns FROM incident WHERE id = ?2), 9223372036854775807), coalesce(?2, 9223372036854775807)) \
                 AND (?3 IS NULL OR incident.kind = ?3) AND (?4 IS NULL OR host.name = ?4) \
                 ORDER BY incident.at_ns DESC, incident.id DESC LIMIT ?1";
    /// All hosts that have introduced themselves. No parameters.
    HOSTS = concat!("SELECT uuid, name, description, first_seen_ns, last_seen_ns, events, nodes, gaps, missing, quarantined, ",
             crate::stored::gap_columns!(), " FROM host WHERE name IS NOT NULL ORDER BY name, last_seen_ns DESC");
    /// All links, with the times of their first and last clock samples. No parameters.
    LINKS = "SELECT edge.uuid AS edge, edge.name AS edge_name, cloud.uuid AS cloud, \
             coalesce(cloud.name, link.cloud_name) AS cloud_name, link.network, \
             (SELECT min(at_ns) FROM clock_sample WHERE clock_sample.link = link.id) AS first_ns, \
             (SELECT max(at_ns) FROM clock_sample WHERE clock_sample.link = link.id) AS last_ns \
             FROM link JOIN host AS edge ON edge.id = link.edge JOIN host AS cloud ON cloud.id = link.cloud \
             ORDER BY edge_name, cloud_name, link.network, last_ns DESC";
    /// The id of a link: ?1 id of the edge, ?2 id of the cloud (the hosts' random ids), ?3 network.
    LINK = "SELECT link.id FROM link JOIN host AS edge ON edge.id = link.edge JOIN host AS cloud ON cloud.id = link.cloud \
            WHERE edge.uuid = ?1 AND cloud.uuid = ?2 AND link.network = ?3";
    /// The times of the first and the last clock sample within a period: ?1 link, ?2 from, ?3 to.
    // There are two subqueries, because SQLite looks up one end of a key per query; one query with min() and max()
    // would read all samples of the period.
    CLOCK_EXTENT = "SELECT (SELECT min(at_ns) FROM clock_sample WHERE link = ?1 AND at_ns BETWEEN ?2 AND ?3), \
                    (SELECT max(at_ns) FROM clock_sample WHERE link = ?1 AND at_ns BETWEEN ?2 AND ?3)";
    /// The clock samples within a period: ?1 link, ?2 from, ?3 to.
    CLOCK_SAMPLES = concat!("SELECT ", clock_columns!(),
        " FROM clock_sample WHERE link = ?1 AND at_ns BETWEEN ?2 AND ?3 ORDER BY at_ns, window");
    /// The clock samples of each of some buckets, as JSON; one row per bucket. Throughputs are rounded to whole
    /// numbers, because writing fractions would take a fifth of the query's time. ?1 link, ?2 first and last time of
    /// each bucket, a JSON array of pairs.
    CLOCK_BUCKETS = concat!("SELECT (SELECT json_group_array(json_array(", clock_columns!("CAST(", " AS INTEGER)"),
        ")) FROM clock_sample WHERE link = ?1 AND at_ns BETWEEN bucket.value ->> 0 AND bucket.value ->> 1) \
         FROM json_each(?2) AS bucket");
    /// A link's relation periods within a range of times, in the order of their arrival. The newest relation period
    /// may continue, so its end is unlimited. ?1 link, ?2 from, ?3 to.
    RELATION_PERIOD_ORDER = "SELECT window, first_ns, \
                          iif(id = (SELECT max(id) FROM clock_window WHERE link = ?1), 9223372036854775807, last_ns) AS last_ns \
                          FROM clock_window WHERE link = ?1 AND first_ns <= ?3 \
                          AND (last_ns >= ?2 OR id = (SELECT max(id) FROM clock_window WHERE link = ?1)) ORDER BY id";
    /// The relation periods, within a range of times, of all links of an edge over a network, with their assumptions,
    /// in the order of arrival: ?1 edge, ?2 network, ?3 from, ?4 to.
    ASSUMED_PERIODS = "SELECT link.cloud, first_ns, last_ns, clocks, max_drift_ppm, max_drift_change_ppm_per_s, claims_trusted, probes_authenticated \
                       FROM link CROSS JOIN clock_window ON clock_window.link = link.id \
                       WHERE link.edge = ?1 AND link.network = ?2 AND first_ns <= ?4 AND last_ns >= ?3 \
                       ORDER BY clock_window.id";
    /// The newest relation period of a link with its assumptions; the column `cloud` is not used. ?1 link.
    NEWEST_ASSUMED_PERIOD = "SELECT 0 AS cloud, first_ns, last_ns, clocks, max_drift_ppm, max_drift_change_ppm_per_s, \
                             claims_trusted, probes_authenticated FROM clock_window WHERE link = ?1 ORDER BY id DESC LIMIT 1";
    /// The edge and the network of a run, which together select the run's links. A run that names no network has the
    /// default network. ?1 run, ?2 default network.
    RUN_LINKS = "SELECT pipeline.host, coalesce(run.network, ?2) AS network FROM run \
                 JOIN pipeline ON pipeline.id = run.pipeline WHERE run.number = ?1";
    /// The edge, the network and the model of a run, the starts of its first and last iterations, and its earliest and
    /// latest minutes with successful iterations. The minutes are needed because the first iteration does not have the
    /// earliest start if the edge's clock was set back. ?1 run, ?2 default network.
    RUN_EXTENT = "SELECT pipeline.host, coalesce(run.network, ?2) AS network, run.model, \
                  (SELECT started_ns FROM iteration WHERE run = ?1 ORDER BY number LIMIT 1) AS first_ns, \
                  (SELECT started_ns FROM iteration WHERE run = ?1 ORDER BY number DESC LIMIT 1) AS last_ns, \
                  (SELECT min(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = 60) AS first_s, \
                  (SELECT max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = 60) AS last_s \
                  FROM run JOIN pipeline ON pipeline.id = run.pipeline WHERE run.number = ?1";
    /// A page of the one-way delays that statistics include. The cloud is the tree's second host. `CROSS JOIN` fixes
    /// the order of the joins: after joins in another order, SQLite would have to sort the rows. ?1 run, ?2 and ?3
    /// iteration and node of the last delay of the previous page, ?4 limit.
    RUN_DELAYS = "SELECT transit.iteration, transit.node, name.text, transit.sent_ns, transit.received_ns, \
                  transit.raw_ns, transit.source, transit.verdict, transit.sent_raw_ns, transit.received_raw_ns, \
                  node.value, node.lo, node.hi, \
                  (SELECT anchor.host FROM anchor WHERE anchor.run = ?1 AND anchor.iteration = transit.iteration \
                   AND anchor.position = 1) AS cloud \
                  FROM transit \
                  CROSS JOIN iteration ON iteration.run = transit.run AND iteration.number = transit.iteration \
                  CROSS JOIN node ON node.run = transit.run AND node.iteration = transit.iteration \
                  AND node.node = transit.node \
                  CROSS JOIN name ON name.id = node.name \
                  WHERE transit.run = ?1 AND (transit.iteration, transit.node) > (?2, ?3) \
                  AND iteration.warm_up = 0 AND iteration.outcome = 0 AND name.text IN ('upload', 'download') \
                  ORDER BY transit.iteration, transit.node LIMIT ?4";
    /// The id of a link: ?1 edge and ?2 cloud, as ids of the table `host`, ?3 network.
    LINK_BY_IDS = "SELECT id FROM link WHERE edge = ?1 AND cloud = ?2 AND network = ?3";
    /// The relation periods of a link with the times of their first and last samples and exchanges. These times are
    /// readings of the edge's clock that the relation period relates. ?1 link, ?2 from and ?3 to, readings of the
    /// edge's wall clock, ?4 limit.
    // `clocks` is a position in `RelatedClocks::ALL`: 0 and 1 if the edge's related clock is free-running, 2 for wall
    // clocks. NULL also means wall clocks.
    RELATION_PERIODS = "SELECT coalesce(clocks, 2) AS clocks, window, \
                     min(iif(clocks < 2, at_raw_ns, at_ns)) AS first_ns, max(iif(clocks < 2, at_raw_ns, at_ns)) AS last_ns, \
                     min(min(coalesce(upper_sent_ns, lower_sent_ns), coalesce(lower_sent_ns, upper_sent_ns))) AS sent_ns, \
                     max(max(coalesce(upper_returned_ns, lower_returned_ns), coalesce(lower_returned_ns, upper_returned_ns))) \
                       AS returned_ns, \
                     min(iif(clocks < 2, at_ns - at_raw_ns, NULL)) AS ahead_min_ns, \
                     max(iif(clocks < 2, at_ns - at_raw_ns, NULL)) AS ahead_max_ns, \
                     count(coalesce(upper_sent_ns, lower_sent_ns)) AS samples \
                     FROM clock_sample WHERE link = ?1 AND at_ns BETWEEN ?2 AND ?3 AND max_drift_ppm IS NOT NULL \
                     AND (upper_sent_ns IS NOT NULL OR lower_sent_ns IS NOT NULL) \
                     AND (coalesce(clocks, 2) = 2 OR at_raw_ns IS NOT NULL) \
                     GROUP BY window, coalesce(clocks, 2) ORDER BY first_ns LIMIT ?4";
    /// A page of the exchanges of one relation period of wall clocks: ?1 link, ?2 relation period, ?3 time after which
    /// the page begins, ?4 limit.
    CLOCK_EXCHANGES = concat!("SELECT at_ns AS time_ns, ", exchange_columns!(),
        " FROM clock_sample WHERE link = ?1 AND window = ?2 AND at_ns > ?3 AND max_drift_ppm IS NOT NULL \
         ORDER BY at_ns LIMIT ?4");
    /// A page of the exchanges of one relation period of free-running clocks, in the order of the edge's raw clock,
    /// because the wall clock of the edge may have been set back within the relation period. Parameters as in
    /// `CLOCK_EXCHANGES`; the page begins after the sample with the raw time ?3 and the wall time ?5.
    // The first comparison of `at_raw_ns` is needed to use the index.
    CLOCK_EXCHANGES_BY_RAW = concat!("SELECT at_raw_ns AS time_ns, ", exchange_columns!(),
        " FROM clock_sample INDEXED BY clock_sample_by_raw WHERE link = ?1 AND window = ?2 AND at_raw_ns >= ?3 \
         AND (at_raw_ns > ?3 OR at_ns > ?5) AND max_drift_ppm IS NOT NULL ORDER BY at_raw_ns, at_ns LIMIT ?4");
}
