//! Relations between the clocks of a run's edge and the clocks of each of its clouds, from stored samples.
//!
//! A relation period relates one pair of clocks. Therefore there are separate lists of relation periods for times of
//! free-running clocks and for times of wall clocks.

use std::collections::{BTreeSet, HashMap};

use peernet_clock::{RawTime, RelatedClocks, Relation, Span, WallTime};
use sqlx::FromRow;

use super::super::{sql, value_of_number};
use super::relation_periods::{PeriodExtent, Timeline};
use super::rolling::{EXCHANGE_RANGE, RollingRelation};
use crate::column::count;
use crate::error::StoreError;
use crate::readers::Readers;

/// Name of the requested data in errors.
const WHAT: &str = "clock samples";
/// Time after the start of the last iteration in which delays of this iteration may occur.
const MAX_ITERATION: Span = Span::from_seconds(600);
/// Maximum number of relation periods of one link within a run; later relation periods are ignored.
const MAX_PERIODS: u32 = 10_000;
/// Maximum number of clouds of one run in memory, and of relations of one cloud in memory. When the maximum is reached,
/// all of them are discarded; they are read again when needed.
const MAX_CACHED: usize = 16;
/// Tolerance of the comparison in [`RelationPeriod::matches_clocks`]: the edge's wall clock may be slewed between two
/// samples.
const MAX_SLEW: Span = Span::from_seconds(1);

/// A time of the edge, as a transit's stamp states it.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeTime {
    /// The clocks that the transit's stamps belong to.
    pub(super) clocks: RelatedClocks,
    /// Reading of the edge's related clock.
    pub(super) at: RawTime,
    /// Reading of the edge's wall clock.
    pub(super) wall: WallTime,
}

/// A stored relation period: a period between two steps of a clock, in which one clock relation holds.
#[derive(FromRow)]
struct RelationPeriod {
    clocks: u8,
    #[sqlx(rename = "window")]
    number: i64,
    // Times of the first and last samples and exchanges, as in `PeriodExtent`. These four times are readings of the
    // edge's related clock.
    first_ns: i64,
    last_ns: i64,
    sent_ns: i64,
    returned_ns: i64,
    /// Smallest and largest difference between the edge's wall clock and its raw clock in the relation period's
    /// samples; `None` if the relation period relates wall clocks.
    ahead_min_ns: Option<i64>,
    ahead_max_ns: Option<i64>,
    samples: i64,
}

impl RelationPeriod {
    /// Returns whether the difference between the edge's wall clock and its raw clock at this time is the same as in
    /// the relation period's samples. After a restart of the machine, the raw clock may show the same times again, but
    /// with another difference.
    fn matches_clocks(&self, time: EdgeTime) -> bool {
        let ahead = time.wall.unix_nanos().saturating_sub(time.at.nanos());
        let tolerance = MAX_SLEW.nanos();
        self.ahead_min_ns.is_none_or(|min| min.saturating_sub(tolerance) <= ahead)
            && self.ahead_max_ns.is_none_or(|max| ahead <= max.saturating_add(tolerance))
    }
}

/// The clouds of a run. A cloud is identified by its id in the table `host`.
pub(super) struct Clouds<'a> {
    readers: &'a Readers,
    edge: i64,
    network: &'a str,
    first_and_last_start: (WallTime, WallTime),
    /// Clouds that were read, by their ids; `None` for a host without a link to the edge.
    cache: HashMap<i64, Option<Cloud>>,
    /// Link, relation period and number of samples of the relation periods that were used. Each relation period is
    /// counted once, however many delays use it.
    used_periods: BTreeSet<(i64, i64, i64)>,
}

/// A cloud with a link.
struct Cloud {
    link: i64,
    /// For each pair of related clocks, the relation periods that relate this pair.
    periods: HashMap<RelatedClocks, RelationPeriods>,
    /// Relation periods whose relations are in memory, by the related clocks and the number of the relation period.
    rolling: HashMap<(RelatedClocks, i64), RollingRelation>,
}

/// The relation periods that relate one pair of clocks.
struct RelationPeriods {
    periods: Vec<RelationPeriod>,
    timeline: Timeline,
}

impl RelationPeriods {
    fn new(periods: Vec<RelationPeriod>) -> Self {
        let at = RawTime::from_nanos;
        let extents: Vec<PeriodExtent> = periods
            .iter()
            .map(|period| PeriodExtent {
                first: at(period.first_ns),
                last: at(period.last_ns),
                sent: at(period.sent_ns),
                returned: at(period.returned_ns),
            })
            .collect();
        Self { timeline: Timeline::new(&extents), periods }
    }

    /// Returns the relation period to which a time belongs, or `None` if the relation period is uncertain.
    fn at(&self, time: EdgeTime) -> Option<&RelationPeriod> {
        self.periods.get(self.timeline.period(time.at)?).filter(|period| period.matches_clocks(time))
    }
}

impl<'a> Clouds<'a> {
    /// Prepares the clouds of a run of an edge over a network; nothing is read yet. The times are the starts of the
    /// run's first and last iterations.
    pub(super) fn new(
        readers: &'a Readers,
        (edge, network): (i64, &'a str),
        first_and_last_start: (WallTime, WallTime),
    ) -> Self {
        Self {
            readers,
            edge,
            network,
            first_and_last_start,
            cache: HashMap::new(),
            used_periods: BTreeSet::new(),
        }
    }

    /// Returns the relation between the edge's clock and a cloud's clock at a time of the edge's clock, or `None` if no
    /// sample covers this time.
    pub(super) async fn relation(
        &mut self,
        cloud: i64,
        time: EdgeTime,
    ) -> Result<Option<&Relation>, StoreError> {
        if !self.cache.contains_key(&cloud) {
            if self.cache.len() >= MAX_CACHED {
                self.cache.clear();
            }
            let read = self.read_cloud(cloud).await?;
            self.cache.insert(cloud, read);
        }
        let Some(Some(cloud)) = self.cache.get_mut(&cloud) else { return Ok(None) };
        let period = cloud.periods.get(&time.clocks).and_then(|periods| periods.at(time));
        let Some(RelationPeriod { number, samples, .. }) = period else { return Ok(None) };
        self.used_periods.insert((cloud.link, *number, *samples));
        let key = (time.clocks, *number);
        if cloud.rolling.len() >= MAX_CACHED && !cloud.rolling.contains_key(&key) {
            cloud.rolling.clear();
        }
        let new_relation = || RollingRelation::new((cloud.link, *number), time.clocks, time.at);
        cloud.rolling.entry(key).or_insert_with(new_relation).at(self.readers, time.at).await
    }

    /// Returns the number of stored samples in the relation periods that were used. Samples shortly before and after
    /// the run are included.
    pub(super) fn samples(&self) -> u64 {
        self.used_periods.iter().map(|(.., samples)| count(*samples)).sum()
    }

    /// Reads the link over the run's network, and the relation periods of this link. Other networks need no look-up: a
    /// clock relation belongs to a pair of hosts, so the link's samples also contain exchanges of these hosts over
    /// other networks.
    async fn read_cloud(&self, cloud: i64) -> Result<Option<Cloud>, StoreError> {
        let link: Option<i64> = sqlx::query_scalar(sql::LINK_BY_IDS)
            .bind(self.edge)
            .bind(cloud)
            .bind(self.network)
            .fetch_optional(&self.readers.pool())
            .await
            .map_err(self.readers.error_for(WHAT))?;
        let Some(link) = link else { return Ok(None) };
        let (first, last) = self.first_and_last_start;
        let periods: Vec<RelationPeriod> = sqlx::query_as(sql::RELATION_PERIODS)
            .bind(link)
            .bind((first - EXCHANGE_RANGE).unix_nanos())
            .bind((last + MAX_ITERATION + EXCHANGE_RANGE).unix_nanos())
            .bind(MAX_PERIODS)
            .fetch_all(&self.readers.pool())
            .await
            .map_err(self.readers.error_for(WHAT))?;
        let mut by_clocks: HashMap<RelatedClocks, Vec<RelationPeriod>> = HashMap::new();
        for period in periods {
            by_clocks
                .entry(value_of_number(WHAT, RelatedClocks::ALL, period.clocks)?)
                .or_default()
                .push(period);
        }
        let periods =
            by_clocks.into_iter().map(|(clocks, periods)| (clocks, RelationPeriods::new(periods))).collect();
        Ok(Some(Cloud { link, periods, rolling: HashMap::new() }))
    }
}
