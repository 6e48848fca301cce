//! Storing of links and their clock samples: one row per link and second.

use std::collections::HashMap;

use peernet_clock::{
    DelaySource, Exchange, Interval, Offset, RawTime, RelatedClocks, Span, Verdict, WallTime,
};
use peernet_logger::{HostId, Slug};
use peernet_stream::{ClockSample, DelaySecond, EstimateBasis, NetworkName};
use sqlx::error::BoxDynError;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Arguments, SqliteConnection};

use super::Refusal;
use super::entities::Entities;
use super::prepared::position;
use crate::column::column;
use crate::extent::Extent;
use crate::plausible;

/// Maximum number of links in the cache. When it is reached, all cached links are discarded. A link is read again when
/// it is needed.
const MAX_CACHED_LINKS: usize = 10_000;

/// Stores a clock sample. The sample replaces an earlier sample of the same second, as in the live state: an agent may
/// send several samples of a second, and each of them covers the second from its start.
const INSERT: &str = "INSERT OR REPLACE INTO clock_sample (link, at_ns, window, max_drift_ppm, \
     upper_sent_ns, upper_received_ns, upper_replied_ns, upper_returned_ns, upper_uncertainty_ns, \
     lower_sent_ns, lower_received_ns, lower_replied_ns, lower_returned_ns, lower_uncertainty_ns, \
     offset_ns, offset_lo_ns, offset_hi_ns, offset_source, offset_verdict, offset_sources, skew_ppm, exchanges, age_ns, \
     probes_sent, probes_answered, probes_lost, probes_refused, round_trip_min_ns, round_trip_median_ns, \
     up_count, up_ns, up_lo_ns, up_hi_ns, up_bits_per_second, up_verdict, \
     down_count, down_ns, down_lo_ns, down_hi_ns, down_bits_per_second, down_verdict, \
     taken, impossible, outliers, stepped, restarts, \
     clocks, at_raw_ns, proven_skew_min_ppm, proven_skew_max_ppm, grown_window_ns) \
     VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, \
     ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)";

/// Selects the time under which a sample of a relation period is stored. A sample that is already stored keeps its
/// time. A wall clock that was set back shows the same times again, while the relation period of free-running clocks
/// continues. If several samples of a relation period have the same wall time, each further sample is stored under a
/// time that is one nanosecond earlier. A sample's time is the end of its second, so the earlier times still lie in
/// this second. ?1 link, ?2 the sample's time, ?3 relation period, ?4 the reading of the free-running clock at that
/// time.
const SAMPLE_TIME: &str = "SELECT coalesce( \
     (SELECT max(at_ns) FROM clock_sample WHERE link = ?1 AND at_ns BETWEEN ?2 - 999 AND ?2 AND window = ?3 AND at_raw_ns = ?4), \
     ?2 - (SELECT count(*) FROM clock_sample WHERE link = ?1 AND at_ns BETWEEN ?2 - 999 AND ?2 AND window = ?3 AND at_raw_ns <> ?4))";

/// Stores the assumptions of a relation period, which are those of its newest sample. Probes count as authenticated
/// only if the probes of all samples of the relation period were authenticated.
const RELATION_PERIOD: &str = "INSERT INTO clock_window (link, window, first_ns, last_ns, clocks, max_drift_ppm, \
     max_drift_change_ppm_per_s, claims_trusted, probes_authenticated) VALUES (?1, ?2, ?3, ?3, ?4, ?5, ?6, ?7, ?8) \
     ON CONFLICT (link, window) DO UPDATE SET first_ns = min(first_ns, excluded.first_ns), \
     last_ns = max(last_ns, excluded.last_ns), clocks = excluded.clocks, max_drift_ppm = excluded.max_drift_ppm, \
     max_drift_change_ppm_per_s = excluded.max_drift_change_ppm_per_s, claims_trusted = excluded.claims_trusted, \
     probes_authenticated = min(coalesce(probes_authenticated, excluded.probes_authenticated), \
       coalesce(excluded.probes_authenticated, probes_authenticated))";

/// Records for retention that samples arrived: ?1 link, ?2 the storage clock, ?3 and ?4 the first and the last time of
/// these samples.
const RECORD_ARRIVAL: &str = "UPDATE link SET arriving_from_s = coalesce(arriving_from_s, ?2), \
     arriving_first_ns = min(coalesce(arriving_first_ns, ?3), ?3), \
     arriving_last_ns = max(coalesce(arriving_last_ns, ?4), ?4) WHERE id = ?1";

/// The writer's cache of the table `link`.
#[derive(Debug, Default)]
pub(super) struct Links {
    /// Id of the link and name of the cloud, by the edge's row, the cloud and the network.
    rows: HashMap<(i64, HostId, NetworkName), (i64, Slug)>,
    /// Range of times of the samples that the transaction stores, by link.
    arrived_times: HashMap<i64, Extent>,
}

impl Links {
    /// Stores one second of the relation between an edge's clock and a cloud's clock. If the cloud is unknown, it is
    /// added.
    pub(super) async fn store(
        &mut self,
        connection: &mut SqliteConnection,
        entities: &mut Entities,
        edge: i64,
        sample: &ClockSample,
        now: WallTime,
    ) -> Result<(), Refusal> {
        let link = self.link(connection, entities, edge, sample, now).await?;
        let basis = sample.basis.map(plausible::basis);
        let at = sample_time(connection, link, sample, basis.as_ref()).await?;
        let values = values(link, at, sample, basis).map_err(sqlx::Error::Encode)?;
        sqlx::query_with(INSERT, values).execute(&mut *connection).await?;
        sqlx::query(RELATION_PERIOD)
            .bind(link)
            .bind(sample.relation_period.cast_signed())
            .bind(at)
            .bind(basis.and_then(|basis| position(RelatedClocks::ALL, basis.clocks)))
            .bind(sample.max_drift_ppm)
            .bind(basis.and_then(|basis| basis.max_drift_change_ppm_per_s))
            .bind(basis.map(|basis| basis.claims_trusted))
            .bind(basis.and_then(|basis| basis.probes_authenticated))
            .execute(connection)
            .await?;
        let at = Extent::single(at);
        self.arrived_times.entry(link).and_modify(|extent| *extent = extent.hull(at)).or_insert(at);
        Ok(())
    }

    /// Records for retention which samples of each link arrived. `storage_s` is the reading of the storage clock.
    pub(super) async fn write(
        &mut self,
        connection: &mut SqliteConnection,
        storage_s: i64,
    ) -> Result<(), sqlx::Error> {
        for (link, Extent { first, last }) in self.arrived_times.drain() {
            sqlx::query(RECORD_ARRIVAL)
                .bind(link)
                .bind(storage_s)
                .bind(first)
                .bind(last)
                .execute(&mut *connection)
                .await?;
        }
        Ok(())
    }

    /// Discards the state that is only in memory, because the transaction failed.
    pub(super) fn forget(&mut self) {
        self.rows.clear();
        self.arrived_times.clear();
    }

    /// Returns the id of a sample's link. Adds the link if it is missing.
    async fn link(
        &mut self,
        connection: &mut SqliteConnection,
        entities: &mut Entities,
        edge: i64,
        sample: &ClockSample,
        now: WallTime,
    ) -> Result<i64, Refusal> {
        let key = (edge, sample.peer, sample.network.clone());
        if let Some((link, name)) = self.rows.get(&key)
            // If the cloud was renamed, its new name is stored below.
            && *name == sample.peer_name
        {
            return Ok(*link);
        }
        let cloud = entities.host(connection, sample.peer, now).await?;
        let link = sqlx::query_scalar(
            "INSERT INTO link (edge, cloud, network, cloud_name) VALUES (?, ?, ?, ?) \
             ON CONFLICT (edge, cloud, network) DO UPDATE SET cloud_name = excluded.cloud_name RETURNING id",
        )
        .bind(edge)
        .bind(cloud)
        .bind(sample.network.as_str())
        .bind(sample.peer_name.as_str())
        .fetch_one(connection)
        .await?;
        if self.rows.len() >= MAX_CACHED_LINKS {
            self.rows.clear();
        }
        self.rows.insert(key, (link, sample.peer_name.clone()));
        Ok(link)
    }
}

/// Returns the time under which a sample is stored, in nanoseconds of the edge's wall clock.
async fn sample_time(
    connection: &mut SqliteConnection,
    link: i64,
    sample: &ClockSample,
    basis: Option<&EstimateBasis>,
) -> Result<i64, sqlx::Error> {
    let at = sample.at.unix_nanos();
    // Without a raw time, a sample with a repeated wall time cannot be distinguished from another sample of the same
    // second.
    let Some(raw) = basis.and_then(|basis| basis.at_raw) else { return Ok(at) };
    sqlx::query_scalar(SAMPLE_TIME)
        .bind(link)
        .bind(at)
        .bind(sample.relation_period.cast_signed())
        .bind(raw.nanos())
        .fetch_one(connection)
        .await
}

/// Returns the values of a row. SQLite stores not-a-number as NULL.
fn values(
    link: i64,
    at: i64,
    sample: &ClockSample,
    basis: Option<EstimateBasis>,
) -> Result<SqliteArguments, BoxDynError> {
    let mut to = SqliteArguments::default();
    to.add(link)?;
    to.add(at)?;
    // SQLite's integers are signed, so the same bits are stored as a signed number.
    to.add(sample.relation_period.cast_signed())?;
    to.add(sample.max_drift_ppm)?;
    add_exchange(sample.upper, &mut to)?;
    add_exchange(sample.lower, &mut to)?;
    // An agent may report any number. Implausible numbers must not reach readers.
    add_offset(sample.offset.as_ref().and_then(plausible::offset).as_ref(), &mut to)?;
    to.add(sample.probes.sent)?;
    to.add(sample.probes.answered)?;
    to.add(sample.probes.lost)?;
    to.add(sample.probes.refused)?;
    to.add(sample.round_trip.map(|trip| trip.min.nanos()))?;
    to.add(sample.round_trip.map(|trip| trip.median.nanos()))?;
    add_delays(sample.up, &mut to)?;
    add_delays(sample.down, &mut to)?;
    let counts = &sample.exchanges;
    for count in [counts.accepted, counts.impossible, counts.outliers, counts.stepped] {
        to.add(column(count))?;
    }
    to.add(counts.restarts)?;
    let skew = basis.and_then(|basis| basis.proven_skew_ppm);
    to.add(basis.and_then(|basis| position(RelatedClocks::ALL, basis.clocks)))?;
    to.add(basis.and_then(|basis| basis.at_raw).map(RawTime::nanos))?;
    to.add(skew.map(|(min, _)| min))?;
    to.add(skew.map(|(_, max)| max))?;
    to.add(basis.and_then(|basis| basis.oldest_exchange_age).map(Span::nanos))?;
    Ok(to)
}

fn add_exchange(exchange: Option<Exchange>, to: &mut SqliteArguments) -> Result<(), BoxDynError> {
    let stamps = |exchange: Exchange| {
        let Exchange { sent, received, replied, returned, uncertainty } = exchange;
        let [sent, received, replied, returned] = [sent, received, replied, returned].map(RawTime::nanos);
        [sent, received, replied, returned, uncertainty.nanos()].map(Some)
    };
    exchange.map_or([None; 5], stamps).into_iter().try_for_each(|stamp| to.add(stamp))
}

fn add_offset(offset: Option<&Offset>, to: &mut SqliteArguments) -> Result<(), BoxDynError> {
    to.add(offset.map(|offset| offset.estimate.nanos()))?;
    to.add(offset.map(|offset| offset.bounds.lo.nanos()))?;
    to.add(offset.map(|offset| offset.bounds.hi.nanos()))?;
    to.add(offset.and_then(|offset| position(DelaySource::ALL, offset.source)))?;
    to.add(offset.and_then(|offset| position(Verdict::ALL, offset.verdict)))?;
    to.add(offset.and_then(sources).map(|sources| serde_json::to_string(&sources)).transpose()?)?;
    to.add(offset.and_then(|offset| offset.skew_ppm))?;
    to.add(offset.map(|offset| column(offset.exchanges)))?;
    to.add(offset.and_then(|offset| offset.age).map(|age| age.nanos()))
}

/// Returns the interval of each source alone; `None` if the only source has the offset's own interval.
fn sources(offset: &Offset) -> Option<Vec<(&'static str, i64, i64)>> {
    // Most offsets have one source. Its list would repeat the values of other columns.
    if offset.sources == [(offset.source, offset.bounds)] {
        return None;
    }
    let row = |(source, interval): &(DelaySource, Interval)| {
        (source.name(), interval.lo.nanos(), interval.hi.nanos())
    };
    Some(offset.sources.iter().map(row).collect())
}

fn add_delays(delays: Option<DelaySecond>, to: &mut SqliteArguments) -> Result<(), BoxDynError> {
    let delays = delays.map(plausible::delays);
    let median = delays.and_then(|delays| delays.median);
    to.add(delays.map(|delays| delays.count))?;
    to.add(median.map(|median| median.value.nanos()))?;
    to.add(median.map(|median| median.bounds.lo.nanos()))?;
    to.add(median.map(|median| median.bounds.hi.nanos()))?;
    to.add(median.and_then(|median| median.bits_per_second))?;
    to.add(delays.and_then(|delays| position(Verdict::ALL, delays.verdict)))
}
