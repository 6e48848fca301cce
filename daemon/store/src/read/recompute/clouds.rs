//! Relations between the clocks of a run's edge and of each cloud, from stored samples.
//!
//! A window relates one pair of clocks: the times of free-running clocks and of wall clocks are looked up separately.

use std::collections::{BTreeSet, HashMap};

use peernet_clock::{RawTime, RelatedClocks, Relation, Span, WallTime};
use sqlx::FromRow;

use super::super::{sql, value_of_number};
use super::rolling::{RollingWindow, SPAN};
use super::windows::{Extent, Timeline};
use crate::column::count;
use crate::error::StoreError;
use crate::readers::Readers;

const WHAT: &str = "clock samples";
/// Upper limit of an iteration's duration.
const MAX_ITERATION: Span = Span::from_seconds(600);
/// Maximum number of windows of one link within a run; later windows are ignored.
const MAX_WINDOWS: u32 = 10_000;
/// Maximum number of clouds of one run, and of relations of one cloud, in memory; beyond it, all are read again when needed.
const MAX_CACHED: usize = 16;
/// Tolerance of the difference between the edge's wall clock and its raw one, compared with that in a window's samples: the wall
/// clock may be slewed between two samples.
const MAX_SLEW: Span = Span::from_seconds(1);

/// A time of the edge as a stamp of a transit shows it.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeTime {
    /// The clocks that the transit's stamps belong to.
    pub(super) clocks: RelatedClocks,
    /// Reading of the edge's related clock.
    pub(super) at: RawTime,
    /// Reading of the edge's wall clock.
    pub(super) wall: WallTime,
}

/// A stored window.
#[derive(FromRow)]
struct Window {
    clocks: u8,
    window: i64,
    // Readings of the edge's related clock.
    first_ns: i64,
    last_ns: i64,
    sent_ns: i64,
    returned_ns: i64,
    /// Difference of the edge's wall clock and its raw one; `None` if wall clocks are related.
    ahead_min_ns: Option<i64>,
    ahead_max_ns: Option<i64>,
    samples: i64,
}

impl Window {
    /// Returns whether the difference of the edge's two clocks is the same as in the window. After another start of the machine it differs,
    /// although the raw clock shows the same times again.
    fn matches_clocks(&self, time: EdgeTime) -> bool {
        let ahead = time.wall.unix_nanos().saturating_sub(time.at.nanos());
        let reach = MAX_SLEW.nanos();
        self.ahead_min_ns.is_none_or(|min| min.saturating_sub(reach) <= ahead)
            && self.ahead_max_ns.is_none_or(|max| ahead <= max.saturating_add(reach))
    }
}

/// The clouds of a run, by their rows in the table `host`.
pub(super) struct Clouds<'a> {
    readers: &'a Readers,
    edge: i64,
    network: &'a str,
    run: (WallTime, WallTime),
    /// Clouds that were read, by row; `None` for a host without a link to the edge.
    cache: HashMap<i64, Option<Cloud>>,
    /// Link, window and number of samples of the windows that were used.
    used: BTreeSet<(i64, i64, i64)>,
}

/// A cloud with a link.
struct Cloud {
    link: i64,
    /// By the related clocks.
    windows: HashMap<RelatedClocks, Windows>,
    rolling: HashMap<(RelatedClocks, i64), RollingWindow>,
}

/// The windows that relate one pair of clocks.
struct Windows {
    windows: Vec<Window>,
    timeline: Timeline,
}

impl Windows {
    fn new(windows: Vec<Window>) -> Self {
        let at = RawTime::from_nanos;
        let extents: Vec<Extent> = windows
            .iter()
            .map(|it| Extent {
                first: at(it.first_ns),
                last: at(it.last_ns),
                sent: at(it.sent_ns),
                returned: at(it.returned_ns),
            })
            .collect();
        Self { timeline: Timeline::new(&extents), windows }
    }

    /// Returns the window of a time, or `None` if it is not certain.
    fn at(&self, time: EdgeTime) -> Option<&Window> {
        self.windows.get(self.timeline.window(time.at)?).filter(|window| window.matches_clocks(time))
    }
}

impl<'a> Clouds<'a> {
    /// Makes it for a run of an edge over a network; `run` holds the starts of its first and last iterations.
    pub(super) fn new(
        readers: &'a Readers,
        (edge, network): (i64, &'a str),
        run: (WallTime, WallTime),
    ) -> Self {
        Self { readers, edge, network, run, cache: HashMap::new(), used: BTreeSet::new() }
    }

    /// Returns the relation of the edge's and a cloud's clocks at a time of the edge's, or `None` if no sample covers it.
    pub(super) async fn relation(
        &mut self,
        cloud: i64,
        time: EdgeTime,
    ) -> Result<Option<&Relation>, StoreError> {
        if !self.cache.contains_key(&cloud) {
            if self.cache.len() >= MAX_CACHED {
                self.cache.clear();
            }
            let found = self.find(cloud).await?;
            self.cache.insert(cloud, found);
        }
        let Some(Some(cloud)) = self.cache.get_mut(&cloud) else { return Ok(None) };
        let window = cloud.windows.get(&time.clocks).and_then(|windows| windows.at(time));
        let Some(Window { window, samples, .. }) = window else { return Ok(None) };
        self.used.insert((cloud.link, *window, *samples));
        let key = (time.clocks, *window);
        if cloud.rolling.len() >= MAX_CACHED && !cloud.rolling.contains_key(&key) {
            cloud.rolling.clear();
        }
        let begin = || RollingWindow::new((cloud.link, *window), time.clocks, time.at);
        cloud.rolling.entry(key).or_insert_with(begin).at(self.readers, time.at).await
    }

    /// Returns the number of stored samples in the windows that were used, including the time around the run in which they count.
    pub(super) fn samples(&self) -> u64 {
        self.used.iter().map(|(.., samples)| count(*samples)).sum()
    }

    /// Reads the link over the run's network. The relation belongs to the pair of hosts: while the run used the link, the link's
    /// samples also hold what was learnt over other networks.
    async fn find(&self, cloud: i64) -> Result<Option<Cloud>, StoreError> {
        let link: Option<i64> = sqlx::query_scalar(sql::LINK_OF)
            .bind(self.edge)
            .bind(cloud)
            .bind(self.network)
            .fetch_optional(&self.readers.pool())
            .await
            .map_err(self.readers.failed(WHAT))?;
        let Some(link) = link else { return Ok(None) };
        let (first, last) = self.run;
        let windows: Vec<Window> = sqlx::query_as(sql::CLOCK_WINDOWS)
            .bind(link)
            .bind((first - SPAN).unix_nanos())
            .bind((last + MAX_ITERATION + SPAN).unix_nanos())
            .bind(MAX_WINDOWS)
            .fetch_all(&self.readers.pool())
            .await
            .map_err(self.readers.failed(WHAT))?;
        let mut by_clocks: HashMap<RelatedClocks, Vec<Window>> = HashMap::new();
        for window in windows {
            by_clocks
                .entry(value_of_number(WHAT, RelatedClocks::ALL, window.clocks)?)
                .or_default()
                .push(window);
        }
        let windows =
            by_clocks.into_iter().map(|(clocks, windows)| (clocks, Windows::new(windows))).collect();
        Ok(Some(Cloud { link, windows, rolling: HashMap::new() }))
    }
}
