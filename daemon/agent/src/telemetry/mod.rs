//! Metrics of the host, read once a second.

mod hardware;
mod metrics_reader;
mod process_cpu_time;

pub(crate) use hardware::hardware;

use std::sync::Arc;
use std::time::Duration;

use peernet_clock::SharedClock;
use peernet_inference::Bank;
use peernet_stream::HostMetrics;
use tokio::sync::watch;
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;

use metrics_reader::MetricsReader;

/// Interval between two readings of the metrics.
const INTERVAL: Duration = Duration::from_secs(1);

/// Reads the metrics until `stop` is cancelled.
pub(crate) async fn run(
    clock: SharedClock,
    bank: Arc<Bank>,
    metrics_sender: watch::Sender<HostMetrics>,
    stop: CancellationToken,
) {
    let mut metrics_reader = MetricsReader::new(clock, bank);
    let mut ticks = tokio::time::interval(INTERVAL);
    // Missed ticks would otherwise follow at once, but a share of CPU time needs some time between two
    // readings.
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    while stop.run_until_cancelled(ticks.tick()).await.is_some() {
        // The metrics are read on a blocking thread, because the temperature sensors of some boards take milliseconds
        // to answer.
        let reading = tokio::task::spawn_blocking(move || {
            let metrics = metrics_reader.read();
            (metrics_reader, metrics)
        });
        match reading.await {
            Ok((returned_reader, metrics)) => {
                metrics_reader = returned_reader;
                metrics_sender.send_replace(metrics);
            }
            Err(error) => {
                tracing::error!(%error, "reading the host's metrics panicked; they are no longer updated");
                return;
            }
        }
    }
}
