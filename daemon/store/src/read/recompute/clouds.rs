//! What the stored samples say of the clocks of a run's edge and of each cloud that it met.
//!
//! A window relates one pair of clocks: the times of free-running clocks and those of wall clocks are looked up apart.

use std::collections::{BTreeSet, HashMap};

use peernet_clock::{RawTime, RelatedClocks, Relation, Span, WallTime};
use sqlx::FromRow;

use super::super::{known, sql};
use super::rolling::{Rolling, SPAN};
use super::windows::{Extent, Timeline};
use crate::column::count;
use crate::error::StoreError;
use crate::readers::Readers;

const WHAT: &str = "clock samples";
/// Iterations last less.
const LONGEST_ITERATION: Span = Span::from_seconds(600);
/// Windows of one link that are told apart within a run; a later one has no say.
const MOST_WINDOWS: u32 = 10_000;
/// Clouds of one run, and relations of one cloud, that are kept at a time; beyond, all are read again when needed.
const MOST: usize = 16;
/// How much further than in a window's samples the edge's wall clock may be ahead of its raw one at a time of the window: it may be slewed
/// between two samples.
const SLEWED: Span = Span::from_seconds(1);

/// A time of the edge, as a stamp of a transit shows it.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeTime {
    /// The clocks that the transit's stamps are of.
    pub(super) clocks: RelatedClocks,
    /// By the edge's clock of the two.
    pub(super) at: RawTime,
    /// By its wall clock.
    pub(super) wall: WallTime,
}

/// One stored window.
#[derive(FromRow)]
struct Window {
    clocks: u8,
    window: i64,
    // By the edge's clock of the two.
    first_ns: i64,
    last_ns: i64,
    sent_ns: i64,
    returned_ns: i64,
    /// How far the edge's wall clock was ahead of its raw one; `None` where wall clocks are related.
    ahead_min_ns: Option<i64>,
    ahead_max_ns: Option<i64>,
    samples: i64,
}

impl Window {
    /// Whether the edge's two clocks stood as they did in the window. After another start of the machine they do not, although its raw
    /// clock shows the same times again.
    fn agrees(&self, time: EdgeTime) -> bool {
        let ahead = time.wall.unix_nanos().saturating_sub(time.at.nanos());
        let reach = SLEWED.nanos();
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
    known: HashMap<i64, Option<Cloud>>,
    /// Samples by link and window, of those that were asked for.
    used: BTreeSet<(i64, i64, i64)>,
}

/// A cloud with a link.
struct Cloud {
    link: i64,
    /// By the clocks that they relate.
    windows: HashMap<RelatedClocks, Windows>,
    rolling: HashMap<(RelatedClocks, i64), Rolling>,
}

/// The windows that relate one pair of clocks.
struct Windows {
    windows: Vec<Window>,
    timeline: Timeline,
}

impl Windows {
    fn of(windows: Vec<Window>) -> Self {
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
        Self { timeline: Timeline::of(&extents), windows }
    }

    /// The window that a time belongs to; `None` where that cannot be told.
    fn at(&self, time: EdgeTime) -> Option<&Window> {
        self.windows.get(self.timeline.window(time.at)?).filter(|window| window.agrees(time))
    }
}

impl<'a> Clouds<'a> {
    /// Of a run of an edge over a network whose first and last iterations began at these times.
    pub(super) fn new(
        readers: &'a Readers,
        (edge, network): (i64, &'a str),
        run: (WallTime, WallTime),
    ) -> Self {
        Self { readers, edge, network, run, known: HashMap::new(), used: BTreeSet::new() }
    }

    /// What is known of the clocks of the edge and a cloud at a time of the edge's; `None` where no sample tells.
    pub(super) async fn relation(
        &mut self,
        cloud: i64,
        time: EdgeTime,
    ) -> Result<Option<&Relation>, StoreError> {
        if !self.known.contains_key(&cloud) {
            if self.known.len() >= MOST {
                self.known.clear();
            }
            let found = self.find(cloud).await?;
            self.known.insert(cloud, found);
        }
        let Some(Some(cloud)) = self.known.get_mut(&cloud) else { return Ok(None) };
        let window = cloud.windows.get(&time.clocks).and_then(|windows| windows.at(time));
        let Some(Window { window, samples, .. }) = window else { return Ok(None) };
        self.used.insert((cloud.link, *window, *samples));
        let key = (time.clocks, *window);
        if cloud.rolling.len() >= MOST && !cloud.rolling.contains_key(&key) {
            cloud.rolling.clear();
        }
        let begin = || Rolling::new((cloud.link, *window), time.clocks, time.at);
        cloud.rolling.entry(key).or_insert_with(begin).at(self.readers, time.at).await
    }

    /// Stored samples of the windows that were asked for, from so long before the run to so long after as they count.
    pub(super) fn samples(&self) -> u64 {
        self.used.iter().map(|(.., samples)| count(*samples)).sum()
    }

    /// Reads the link over the run's network. The relation belongs to the pair of hosts: as long as the run used the link, the
    /// link's samples hold what was learnt over other networks, too.
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
            .bind((last + LONGEST_ITERATION + SPAN).unix_nanos())
            .bind(MOST_WINDOWS)
            .fetch_all(&self.readers.pool())
            .await
            .map_err(self.readers.failed(WHAT))?;
        let mut by_clocks: HashMap<RelatedClocks, Vec<Window>> = HashMap::new();
        for window in windows {
            by_clocks.entry(known(WHAT, RelatedClocks::ALL, window.clocks)?).or_default().push(window);
        }
        let windows = by_clocks.into_iter().map(|(clocks, windows)| (clocks, Windows::of(windows))).collect();
        Ok(Some(Cloud { link, windows, rolling: HashMap::new() }))
    }
}
