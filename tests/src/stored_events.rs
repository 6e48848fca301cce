//! Counts of everything that an aggregator's database stores.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::Path;

use crate::SpooledIterations;
use crate::truth::query_database;

/// Contents of a database, counted in several ways.
#[derive(Clone, Debug)]
pub struct StoredEvents {
    /// Runs by id.
    pub runs: BTreeMap<String, StoredRun>,
    /// Hosts by name.
    pub hosts: BTreeMap<String, StoredHost>,
}

/// Stored counts of a run.
#[derive(Clone, Debug, Default)]
pub struct StoredRun {
    /// Name of its host.
    pub host: String,
    /// Name of its pipeline.
    pub pipeline: String,
    /// Reason of its end; empty while it is still running.
    pub reason: String,
    /// Number of iterations according to the counters in the run's row.
    pub counted_iterations: u64,
    /// Number of successful iterations without warm-up, according to these counters.
    pub ok: u64,
    /// Number of successful iterations in the roll-up of the whole run, and in the roll-ups of seconds.
    pub rolled_up_iterations: (u64, u64),
    /// Ranges of the numbers of the stored iterations.
    pub ranges: Vec<RangeInclusive<u64>>,
    /// Number of iterations that have nodes.
    pub iterations_with_nodes: u64,
    /// Number of iterations whose nodes are not contiguous from 0.
    pub incomplete_iterations: u64,
    /// Number of nodes.
    pub nodes: u64,
    /// Number of events that are missing in the run's gaps.
    pub missing: u64,
}

/// Stored counts of a host.
#[derive(Clone, Debug, Default)]
pub struct StoredHost {
    /// Number of events.
    pub events: u64,
    /// Number of nodes.
    pub nodes: u64,
    /// Number of gaps, according to the host's counters.
    pub gaps: u64,
    /// Number of events that are missing in gaps, according to the host's counters.
    pub missing: u64,
    /// Number of gaps and of missing events, according to the rows of the gaps.
    pub gap_rows: (u64, u64),
    /// Number of quarantined batches.
    pub quarantined: u64,
    /// Number of streams.
    pub streams: u64,
}

// `quantity = 0` selects the roll-ups of the values themselves, not of their bounds.
const RUNS: &str = "
SELECT r.uuid, p.name, coalesce(r.end_reason, ''), r.warm_up + r.ok + r.failed + r.lost + r.timeout, r.ok,
       (SELECT coalesce(sum(count), 0) FROM rollup WHERE run = r.number AND resolution_s = 0 AND quantity = 0
          AND name IN (SELECT id FROM name WHERE text = 'total' AND kind = 'timer')),
       (SELECT coalesce(sum(count), 0) FROM rollup WHERE run = r.number AND resolution_s = 1 AND quantity = 0
          AND name IN (SELECT id FROM name WHERE text = 'total' AND kind = 'timer')),
       (SELECT coalesce(sum(count), 0) FROM gap WHERE run = r.number), coalesce(h.name, h.uuid)
FROM run AS r JOIN pipeline AS p ON p.id = r.pipeline JOIN host AS h ON h.id = p.host ORDER BY r.number";

const RANGES: &str = "
SELECT uuid, min(n), max(n) FROM (
    SELECT run.uuid, i.number AS n, i.number - row_number() OVER (PARTITION BY i.run ORDER BY i.number) AS island
    FROM iteration AS i JOIN run ON run.number = i.run)
GROUP BY uuid, island ORDER BY uuid, min(n)";

const NODES: &str = "
SELECT run.uuid, count(*), sum(t.n <> t.last + 1 OR t.first <> 0), sum(t.n) FROM (
    SELECT run, iteration, count(*) AS n, min(node) AS first, max(node) AS last FROM node GROUP BY run, iteration) AS t
JOIN run ON run.number = t.run GROUP BY run.uuid";

const HOSTS: &str = "
SELECT coalesce(h.name, h.uuid), h.events, h.nodes, h.gaps, h.missing, h.quarantined,
       (SELECT count(*) FROM gap WHERE host = h.id), (SELECT coalesce(sum(count), 0) FROM gap WHERE host = h.id),
       (SELECT count(*) FROM stream WHERE host = h.id)
FROM host AS h";

impl StoredEvents {
    /// Reads a database.
    ///
    /// # Panics
    /// As [`query_database`].
    pub fn read(database: &Path) -> Self {
        let mut runs: BTreeMap<String, StoredRun> = rows(database, RUNS)
            .into_iter()
            .map(|row| {
                let run = StoredRun {
                    host: row[8].clone(),
                    pipeline: row[1].clone(),
                    reason: row[2].clone(),
                    counted_iterations: number(&row[3]),
                    ok: number(&row[4]),
                    rolled_up_iterations: (number(&row[5]), number(&row[6])),
                    missing: number(&row[7]),
                    ..StoredRun::default()
                };
                (row[0].clone(), run)
            })
            .collect();
        for row in rows(database, RANGES) {
            let run = runs.get_mut(&row[0]).expect("joined with its run");
            run.ranges.push(number(&row[1])..=number(&row[2]));
        }
        for row in rows(database, NODES) {
            let run = runs.get_mut(&row[0]).expect("joined with its run");
            (run.iterations_with_nodes, run.incomplete_iterations, run.nodes) =
                (number(&row[1]), number(&row[2]), number(&row[3]));
        }
        let hosts = rows(database, HOSTS).into_iter().map(|row| {
            let column = |index: usize| number(&row[index]);
            let host = StoredHost {
                events: column(1),
                nodes: column(2),
                gaps: column(3),
                missing: column(4),
                quarantined: column(5),
                gap_rows: (column(6), column(7)),
                streams: column(8),
            };
            (row[0].clone(), host)
        });
        Self { runs, hosts: hosts.collect() }
    }

    /// Returns the number of iterations of all runs.
    pub fn iterations(&self) -> u64 {
        self.runs.values().map(StoredRun::iterations).sum()
    }

    /// Returns the number of nodes of all runs.
    pub fn nodes(&self) -> u64 {
        self.runs.values().map(|run| run.nodes).sum()
    }

    /// Checks that rows, counters, roll-ups and nodes agree, so that everything is stored once and completely.
    ///
    /// # Panics
    /// If the counts differ.
    pub fn assert_consistent(&self) {
        for (id, run) in &self.runs {
            let iterations = run.iterations();
            assert_eq!(
                run.counted_iterations, iterations,
                "the counters of run {id} differ from its rows: {run:?}"
            );
            assert_eq!(
                run.rolled_up_iterations,
                (run.ok, run.ok),
                "the roll-ups of run {id} differ from its counters: {run:?}"
            );
            assert_eq!(
                (run.iterations_with_nodes, run.incomplete_iterations),
                (iterations, 0),
                "iterations of run {id} lack nodes: {run:?}"
            );
        }
        for (name, host) in &self.hosts {
            assert_eq!(
                host.gap_rows,
                (host.gaps, host.missing),
                "the gaps of {name} differ from its counters: {host:?}"
            );
        }
        let nodes: u64 = self.hosts.values().map(|host| host.nodes).sum();
        assert_eq!(nodes, self.nodes(), "the hosts' counters of nodes differ from the table: {self:?}");
    }

    /// Returns the number of spooled iterations that are not stored; checks that no more
    /// iterations are stored in the range of a line than the line reports.
    ///
    /// # Panics
    /// If no iteration was spooled, or a run is unknown or contains too many iterations.
    pub fn count_missing(&self, spooled: &[SpooledIterations]) -> u64 {
        assert!(!spooled.is_empty(), "the agent logged no spooled iteration: {self:?}");
        let mut missing = 0;
        for line in spooled {
            let run = self.runs.get(&line.run).unwrap_or_else(|| panic!("the run of {line:?} is not stored"));
            let stored = run.stored_within(line.first, line.last);
            assert!(stored <= line.count, "{stored} stored, more than {line:?}: {:?}", run.ranges);
            missing += line.count - stored;
        }
        missing
    }
}

impl StoredRun {
    /// Returns the number of stored iterations.
    pub fn iterations(&self) -> u64 {
        self.ranges.iter().map(|range| range.end() - range.start() + 1).sum()
    }

    /// Returns the number of stored iterations between two numbers.
    pub fn stored_within(&self, first: u64, last: u64) -> u64 {
        let stored = |range: &RangeInclusive<u64>| {
            let (first, last) = (first.max(*range.start()), last.min(*range.end()));
            (last + 1).saturating_sub(first)
        };
        self.ranges.iter().map(stored).sum()
    }

    /// Returns the number of missing iterations between 1 and the last stored one.
    pub fn missing_iterations(&self) -> u64 {
        self.ranges.last().map_or(0, |range| *range.end()) - self.iterations()
    }

    /// Returns whether all iterations from number 1 to the last stored one are stored.
    pub fn is_contiguous(&self) -> bool {
        matches!(self.ranges.as_slice(), [range] if *range.start() == 1)
    }
}

fn rows(database: &Path, sql: &str) -> Vec<Vec<String>> {
    query_database(database, sql).lines().map(|line| line.split('|').map(str::to_owned).collect()).collect()
}

fn number(text: &str) -> u64 {
    text.parse().unwrap_or_else(|_| panic!("{text:?} is not a count"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spooled(first: u64, last: u64) -> SpooledIterations {
        SpooledIterations { run: "a".to_owned(), batch: 1, first, last, count: last - first + 1 }
    }

    #[test]
    fn missing_spooled_iterations_are_counted() {
        let mut stored_events = StoredEvents { runs: BTreeMap::new(), hosts: BTreeMap::new() };
        let run = StoredRun { ranges: vec![1..=10, 13..=20], ..StoredRun::default() };
        assert_eq!((run.iterations(), run.missing_iterations(), run.is_contiguous()), (18, 2, false));
        stored_events.runs.insert("a".to_owned(), run);
        assert_eq!(stored_events.count_missing(&[spooled(1, 10), spooled(14, 20)]), 0);
        assert_eq!(stored_events.count_missing(&[spooled(9, 11), spooled(12, 13), spooled(30, 31)]), 4);
    }

    #[test]
    #[should_panic(expected = "differ from its rows")]
    fn counters_above_stored_rows_are_detected() {
        let run = StoredRun { ranges: vec![1..=10], counted_iterations: 11, ..StoredRun::default() };
        StoredEvents { runs: BTreeMap::from([("a".to_owned(), run)]), hosts: BTreeMap::new() }
            .assert_consistent();
    }
}
