//! Every statement that answers a question. Parameters are numbered, so that each reads on its own.

macro_rules! statements {
    ($($(#[$doc:meta])* $name:ident = $text:expr;)*) => {
        $($(#[$doc])* pub(crate) const $name: &str = $text;)*

        /// All of them by name: a test looks at their plans.
        #[cfg(test)]
        pub(crate) const ALL: &[(&str, &str)] = &[$((stringify!($name), $text)),*];
    };
}

macro_rules! run_columns {
    () => {
        "SELECT run.number, run.uuid, host.uuid AS host_uuid, host.name AS host_name, pipeline.name AS pipeline, \
         run.placement, run.peer, run.network, run.address, run.model, run.device, run.started_ns, run.ended_ns, \
         run.end_reason, run.last_iteration_ns, run.warm_up, run.ok, run.failed, run.lost, run.timeout, \
         run.facts, run.configuration, run.version \
         FROM run JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host "
    };
}

macro_rules! rollup_columns {
    () => {
        "SELECT name.text, name.unit, rollup.name, rollup.quantity, rollup.bucket_s, rollup.count, rollup.mean, \
         rollup.m2, rollup.min, rollup.max, rollup.sketch \
         FROM rollup JOIN name ON name.id = rollup.name "
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
    /// ?1 before, ?2 limit.
    RUNS = concat!(run_columns!(), "WHERE run.number < ?1 ORDER BY run.number DESC LIMIT ?2");
    /// ?1 before, ?2 limit, ?3 pipeline or NULL, ?4 host or NULL.
    RUNS_FILTERED = concat!(run_columns!(),
        "WHERE run.number < ?1 AND run.pipeline IN (SELECT pipeline.id FROM pipeline JOIN host ON host.id = pipeline.host \
         WHERE (?3 IS NULL OR pipeline.name = ?3) AND (?4 IS NULL OR host.uuid = ?4)) \
         ORDER BY run.number DESC LIMIT ?2");
    /// ?1 number.
    RUN = concat!(run_columns!(), "WHERE run.number = ?1");
    /// ?1 run.
    GAPS = "SELECT from_ns, to_ns, count, reason FROM gap WHERE run = ?1 ORDER BY from_ns LIMIT 1000";
    /// Summaries of one name over a whole run: ?1 run, ?2 name.
    ROLLUP_OF_NAME = concat!(rollup_columns!(),
        "WHERE rollup.run = ?1 AND rollup.resolution_s = 0 AND rollup.quantity = 0 \
         AND rollup.name IN (SELECT id FROM name WHERE text = ?2)");
    /// Summaries of all names over a whole run: ?1 run.
    ROLLUPS = concat!(rollup_columns!(), "WHERE rollup.run = ?1 AND rollup.resolution_s = 0");
    /// Summaries of one name over time: ?1 run, ?2 name, ?3 resolution.
    ROLLUPS_OVER_TIME = concat!(rollup_columns!(),
        "WHERE rollup.run = ?1 AND rollup.resolution_s = ?3 AND rollup.quantity = 0 \
         AND rollup.name IN (SELECT id FROM name WHERE text = ?2) ORDER BY rollup.bucket_s");
    /// ?1 run.
    VERDICTS = "SELECT name.text, verdict_count.verdict, verdict_count.count FROM verdict_count \
                JOIN name ON name.id = verdict_count.name WHERE verdict_count.run = ?1 ORDER BY verdict_count.verdict";
    /// First and last bucket that any name has: ?1 run, ?2 resolution, ?3 name.
    EXTENT = "SELECT min(bucket_s), max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND quantity = 0 \
              AND name IN (SELECT id FROM name WHERE text = ?3)";
    /// ?1 run, ?2 limit.
    SLOWEST = concat!(iteration_columns!(),
        "WHERE run = ?1 AND warm_up = 0 AND outcome = 0 AND total IS NOT NULL ORDER BY total DESC LIMIT ?2");
    /// ?1 run, ?2 after, ?3 limit.
    ITERATIONS = concat!(iteration_columns!(), "WHERE run = ?1 AND number > ?2 ORDER BY number LIMIT ?3");
    /// ?1 run, ?2 after, ?3 limit.
    ITERATIONS_WITHOUT_ANSWER = concat!(iteration_columns!("iteration_without_answer"),
        "WHERE run = ?1 AND number > ?2 AND outcome <> 0 ORDER BY number LIMIT ?3");
    /// ?1 run, ?2 number.
    ITERATION = concat!(iteration_columns!(), "WHERE run = ?1 AND number = ?2");
    /// Durations of one iteration, for a row of a list: ?1 run, ?2 number.
    DURATIONS = "SELECT name.text, node.value FROM node JOIN name ON name.id = node.name \
                 WHERE node.run = ?1 AND node.iteration = ?2 AND node.value IS NOT NULL AND name.unit = 's'";
    /// ?1 run, ?2 number.
    NODES = "SELECT node.node, node.parent, node.host, node.start_ns, node.value, node.lo, node.hi, \
             name.text, name.kind, name.custom, name.unit FROM node JOIN name ON name.id = node.name \
             WHERE node.run = ?1 AND node.iteration = ?2 ORDER BY node.node";
    /// ?1 run, ?2 number.
    TRANSITS = "SELECT node, sent_ns, received_ns, raw_ns, source, verdict FROM transit \
                WHERE run = ?1 AND iteration = ?2 ORDER BY node";
    /// The host that senses: ?1 run.
    EDGE = "SELECT host.uuid, host.name FROM run JOIN pipeline ON pipeline.id = run.pipeline \
            JOIN host ON host.id = pipeline.host WHERE run.number = ?1";
    /// ?1 run, ?2 number.
    ANCHORS = "SELECT host.uuid, host.name, anchor.wall_ns FROM anchor JOIN host ON host.id = anchor.host \
               WHERE anchor.run = ?1 AND anchor.iteration = ?2 ORDER BY anchor.position";
    /// How many are slower, as far as a thousand: ?1 run, ?2 total.
    SLOWER = "SELECT count(*) FROM (SELECT 1 FROM iteration WHERE run = ?1 AND warm_up = 0 AND outcome = 0 \
              AND total IS NOT NULL AND total > ?2 LIMIT 1000)";
    /// ?1 run, ?2 number.
    PREVIOUS = "SELECT max(number) FROM iteration WHERE run = ?1 AND number < ?2";
    /// ?1 run, ?2 number.
    NEXT = "SELECT min(number) FROM iteration WHERE run = ?1 AND number > ?2";
    /// ?1 limit, ?2 id of the last of the page before or NULL.
    INCIDENTS = "SELECT incident.id, incident.at_ns, incident.kind, host.uuid AS host, host.name AS host_name, \
                 incident.pipeline, incident.run, peer.name AS peer, incident.text \
                 FROM incident JOIN host ON host.id = incident.host LEFT JOIN host AS peer ON peer.id = incident.peer \
                 WHERE (incident.at_ns, incident.id) < \
                   (coalesce((SELECT at_ns FROM incident WHERE id = ?2), 9223372036854775807), coalesce(?2, 9223372036854775807)) \
                 ORDER BY incident.at_ns DESC, incident.id DESC LIMIT ?1";
    /// No parameters.
    HOSTS = "SELECT uuid, name, description, first_seen_ns, last_seen_ns, events, nodes, gaps, missing, quarantined \
             FROM host WHERE name IS NOT NULL ORDER BY name";
}
