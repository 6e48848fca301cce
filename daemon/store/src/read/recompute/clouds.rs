//! What the stored samples say of the clocks of a run's edge and of each cloud that it met.

use std::collections::{BTreeSet, HashMap};

use peernet_clock::{Relation, Span, WallTime};
use sqlx::FromRow;

use super::super::{sql, wall};
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

/// One stored window.
#[derive(FromRow)]
struct Window {
    window: i64,
    first_ns: i64,
    last_ns: i64,
    sent_ns: i64,
    returned_ns: i64,
    samples: i64,
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
    windows: Vec<Window>,
    timeline: Timeline,
    rolling: HashMap<usize, Rolling>,
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
        at: WallTime,
    ) -> Result<Option<&Relation>, StoreError> {
        if !self.known.contains_key(&cloud) {
            if self.known.len() >= MOST {
                self.known.clear();
            }
            let found = self.find(cloud).await?;
            self.known.insert(cloud, found);
        }
        let Some(Some(cloud)) = self.known.get_mut(&cloud) else { return Ok(None) };
        let Some(place) = cloud.timeline.window(at) else { return Ok(None) };
        let Some(Window { window, samples, .. }) = cloud.windows.get(place) else { return Ok(None) };
        self.used.insert((cloud.link, *window, *samples));
        if cloud.rolling.len() >= MOST && !cloud.rolling.contains_key(&place) {
            cloud.rolling.clear();
        }
        let rolling = cloud.rolling.entry(place).or_insert_with(|| Rolling::new(cloud.link, *window, at));
        rolling.at(self.readers, at).await
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
        let extents: Vec<Extent> = windows
            .iter()
            .map(|it| Extent {
                first: wall(it.first_ns),
                last: wall(it.last_ns),
                sent: wall(it.sent_ns),
                returned: wall(it.returned_ns),
            })
            .collect();
        let timeline = Timeline::of(&extents);
        Ok(Some(Cloud { link, windows, timeline, rolling: HashMap::new() }))
    }
}
