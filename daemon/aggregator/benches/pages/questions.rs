//! The queries of each page and API resource, for the largest run.

use std::future::Future;

use peernet_clock::{SharedClock, Span};
use peernet_logger::{Name, stage};
use peernet_store::{IncidentFilter, IterationFilter, RunFilter, Store, StoreError};

/// Number of measurements per query.
const REPEATS: usize = 20;
/// Sizes that the pages request: points of a run's series, points of a link's series, buckets of a run over time, bins of a
/// histogram, and number of the slowest iterations.
const POINTS: usize = 240;
const CLOCK_POINTS: u32 = 360;
const BUCKETS: usize = 120;
const BINS: usize = 48;
const SLOWEST: u32 = 40;
/// Rows of the run page's table of iterations without an answer.
const UNANSWERED: u32 = 8;
/// Limits of the comparison page: runs chosen one by one, runs of an experiment, runs that are drawn over time, and points
/// of each drawn run.
const CHOSEN_RUNS: u32 = 12;
const EXPERIMENT_RUNS: u32 = 200;
const MAX_TIME_SERIES: usize = 24;
const TIME_SERIES_POINTS: usize = 100;
/// Number of iterations whose answer size is drawn against the latency.
const PAIRS: u32 = 750;

/// Response times of one query.
#[derive(Debug)]
pub(crate) struct ResponseTimes {
    pub(crate) question: &'static str,
    pub(crate) median_ms: f64,
    pub(crate) max_ms: f64,
}

/// Measures all queries.
pub(crate) async fn measure(store: &Store, clock: &SharedClock) -> Vec<ResponseTimes> {
    let newest = store.runs(&RunFilter { limit: 1, ..RunFilter::default() }).await.expect("answers");
    let run = newest.first().expect("there is a run");
    let (number, host) = (run.number, run.host);
    let last = run.counts.ok + run.counts.timeout;
    let end = run.last_iteration.expect("it has iterations");
    let links = store.links().await.expect("answers");
    let link = links.first().expect("there is a link");
    let key = &link.key();
    let slowest = store.slowest_iterations(number, 1_000).await.expect("answers");
    let slow_number = slowest.last().expect("there are some").number;
    let [total, upload] = [stage::TOTAL, stage::UPLOAD];
    let chosen =
        store.runs(&RunFilter { limit: CHOSEN_RUNS, ..RunFilter::default() }).await.expect("answers");
    let experiments = store.experiments(1).await.expect("answers");
    let experiment = experiments.first().expect("there is an experiment").id.clone();
    let stages = stage::ORDER;
    let difference_stages: Vec<Name> =
        [stage::TOTAL, stage::STAGES_TOTAL].into_iter().chain(stages.clone()).collect();
    let (bytes, inference) = (stage::DOWNLOAD_BYTES, stage::INFERENCE);
    let lengths = [bytes.as_str(), inference.as_str()];
    let names = [stage::TOTAL, stage::SENSING, stage::UPLOAD, stage::INFERENCE, stage::DOWNLOAD];
    let page = |after: u64, without_answer: bool| IterationFilter { after, limit: 100, without_answer };
    let (first, end_of_list) = (page(0, false), page(last.saturating_sub(100), false));
    let later_lost = page(last / 2, true);
    let unanswered = IterationFilter { limit: UNANSWERED, ..page(0, true) };
    let all_runs = RunFilter::default();
    let incidents = IncidentFilter::newest(100);
    let runs_of_host = RunFilter {
        host: Some(host),
        pipeline: Some("line".parse().expect("a name")),
        ..RunFilter::default()
    };
    let day = end - Span::from_seconds(86_400);

    vec![
        time("run page", clock, async || {
            tokio::try_join!(
                store.run(number),
                store.statistics_of(number),
                store.histogram(number, &total, BINS),
                store.series(number, &names[..1], POINTS),
                store.slowest_iterations(number, SLOWEST),
                store.iterations(number, &unanswered),
                store.stage_buckets(number, &names[..1], BUCKETS),
                store.episodes(number),
            )
        })
        .await,
        time("trust report of a run that drifted", clock, async || {
            tokio::try_join!(
                store.run(number),
                store.statistics_of(number),
                store.stage_buckets(number, &names[..1], BUCKETS),
                store.stage_buckets(number, &stages, BUCKETS),
            )
        })
        .await,
        time("compare page, two runs", clock, async || {
            for number in [number, number] {
                store.run(number).await?;
                store.stage_means(number, &difference_stages, BUCKETS).await?;
                over_time(store, number).await?;
                store.value_pairs(number, lengths, PAIRS).await?;
            }
            store.statistics(&[number, number]).await
        })
        .await,
        time("compare page, twelve runs", clock, async || {
            for run in &chosen {
                store.run(run.number).await?;
                over_time(store, run.number).await?;
            }
            let numbers: Vec<i64> = chosen.iter().map(|run| run.number).collect();
            store.statistics(&numbers).await
        })
        .await,
        time("compare page, experiment", clock, async || {
            let runs = store.runs_of_experiment(&experiment, EXPERIMENT_RUNS).await?;
            let numbers: Vec<i64> = runs.iter().map(|run| run.number).collect();
            for number in numbers.iter().take(MAX_TIME_SERIES) {
                over_time(store, *number).await?;
            }
            store.statistics(&numbers).await
        })
        .await,
        time("a run over time", clock, || over_time(store, number)).await,
        time("pairs of 750 iterations", clock, || store.value_pairs(number, lengths, PAIRS)).await,
        time("experiments", clock, || store.experiments(50)).await,
        time("iteration page", clock, async || {
            tokio::try_join!(store.run(number), store.iteration(number, last / 2))
        })
        .await,
        time("run", clock, || store.run(number)).await,
        time("stages", clock, || store.statistics_of(number)).await,
        time("histogram", clock, || store.histogram(number, &upload, BINS)).await,
        time("series of one name", clock, || store.series(number, &names[..1], POINTS)).await,
        time("series of five names", clock, || store.series(number, &names, POINTS)).await,
        time("iterations, first page", clock, || store.iterations(number, &first)).await,
        time("iterations, last page", clock, || store.iterations(number, &end_of_list)).await,
        time("iterations without answer", clock, || store.iterations(number, &later_lost)).await,
        time("forty slowest", clock, || store.slowest_iterations(number, SLOWEST)).await,
        time("thousand slowest", clock, || store.slowest_iterations(number, 1_000)).await,
        time("one iteration", clock, || store.iteration(number, last / 2)).await,
        time("one of the slowest", clock, || store.iteration(number, slow_number)).await,
        time("hosts", clock, || store.hosts()).await,
        time("runs", clock, || store.runs(&all_runs)).await,
        time("runs of a pipeline", clock, || store.runs(&runs_of_host)).await,
        time("incidents", clock, || store.incidents(&incidents)).await,
        time("links", clock, || store.links()).await,
        time("a link's hour", clock, || {
            store.clock_series(key, end - Span::from_seconds(3_600), end, CLOCK_POINTS)
        })
        .await,
        time("a link's day", clock, || store.clock_series(key, day, end, CLOCK_POINTS)).await,
    ]
}

/// Runs the comparison page's queries of one run over time.
async fn over_time(store: &Store, run: i64) -> Result<(), StoreError> {
    let names: Vec<Name> = [stage::TOTAL, stage::UNATTRIBUTED].into_iter().chain(stage::ORDER).collect();
    tokio::try_join!(
        store.series(run, &names[..1], TIME_SERIES_POINTS),
        store.stage_means(run, &names, TIME_SERIES_POINTS),
        store.episodes(run),
    )
    .map(drop)
}

/// Measures one query `REPEATS` times.
async fn time<T, F: Future<Output = Result<T, StoreError>>>(
    question: &'static str,
    clock: &SharedClock,
    run_query: impl Fn() -> F,
) -> ResponseTimes {
    let mut durations_ms = Vec::with_capacity(REPEATS);
    for _ in 0..REPEATS {
        let started_at = clock.mono();
        run_query().await.unwrap_or_else(|error| panic!("{question}: {error}"));
        durations_ms.push((clock.mono() - started_at).seconds() * 1e3);
    }
    durations_ms.sort_by(f64::total_cmp);
    ResponseTimes { question, median_ms: durations_ms[REPEATS / 2], max_ms: durations_ms[REPEATS - 1] }
}
