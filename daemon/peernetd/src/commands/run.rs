//! The command `peernetd run`. The order of its steps is fixed: temporary log, configuration with all checks,
//! configured log, runtime, parts, READY.

use std::path::Path;
use std::time::Duration;

use futures::{FutureExt, TryFutureExt};
use peernet_agent::Agent;
use peernet_aggregator::Aggregator;
use peernet_networks::descriptors::{DescriptorShare, raise_limit};
use tracing::{info, warn};

use crate::configuration::{Configuration, load};
use crate::lifecycle::Lifecycle;
use crate::log;
use peernet_cli::VERSION;
use peernet_cli::exit::{Exit, Failure, error_line};
use peernet_cli::output::print_to_stderr;

/// Time for blocking threads to end after all tasks have ended.
const BLOCKING_THREADS_TIMEOUT: Duration = Duration::from_secs(1);

/// Runs the roles of a configuration file until a signal arrives.
pub(crate) fn run(file: &Path) -> Exit {
    let temporary_log = log::install_temporary();
    let configuration = match load(file) {
        Ok(configuration) => configuration,
        Err(problems) => {
            for problem in problems {
                print_to_stderr(problem);
            }
            return Exit::Configuration;
        }
    };
    // The temporary log of this thread would take precedence over the log of the process, which is installed next.
    drop(temporary_log);
    if let Err(error) = log::install(&configuration.log) {
        print_to_stderr(format_args!("{}: {}", file.display(), error_line(&error)));
        return Exit::Configuration;
    }
    info!("peernetd {VERSION} with {}", file.display());
    for line in &configuration.deprecation_lines {
        warn!("deprecated: {line}");
    }
    // The limit of open files must be raised before a listener computes its share of the limit.
    if let Err(error) = raise_limit() {
        warn!(
            "cannot raise the limit of open files of this process: {error}; continuing with the current limit"
        );
    }

    let runtime =
        match tokio::runtime::Builder::new_multi_thread().thread_name("peernetd").enable_all().build() {
            Ok(runtime) => runtime,
            Err(error) => {
                tracing::error!("cannot start the runtime's threads: {error}");
                return Exit::Unavailable;
            }
        };
    let exit = runtime.block_on(run_parts(configuration)).unwrap_or_else(|failure| {
        tracing::error!("{failure}");
        failure.exit
    });
    // Dropping the runtime would wait for blocking calls without a limit.
    runtime.shutdown_timeout(BLOCKING_THREADS_TIMEOUT);
    exit
}

/// Starts the parts and runs them until the end of the process. The aggregator starts before the agent that sends to
/// it.
async fn run_parts(configuration: Configuration) -> Result<Exit, Failure> {
    let unavailable = |error: anyhow::Error| Failure::new(Exit::Unavailable, error);
    let clock = configuration.clock().map_err(|error| unavailable(error.into()))?;
    let agent_clock = configuration.agent_clock(&clock).map_err(|error| unavailable(error.into()))?;
    // The signal handlers are installed before the parts start, so that no signal is lost during the start.
    let mut lifecycle =
        Lifecycle::new(&configuration.lifecycle).map_err(|error| unavailable(error.into()))?;

    if let Some(config) = configuration.aggregator {
        let mut handle = None;
        let part_clock = clock.clone();
        lifecycle
            .start("aggregator", async |stop| {
                let running = Aggregator::start(config, part_clock, stop).await?;
                handle = Some(running.handle.clone());
                Ok(running.join().map_err(anyhow::Error::new).boxed())
            })
            .await
            .map_err(unavailable)?;
        if let (Some(config), Some(aggregator)) = (configuration.web, handle) {
            let part_clock = clock.clone();
            lifecycle
                .start("web server", async |stop| {
                    let connections = DescriptorShare::Web.max_connections();
                    let running =
                        peernet_web::serve(config, aggregator, part_clock, stop, connections).await?;
                    info!("dashboard: http://{}", running.address());
                    Ok(running.join().map_err(anyhow::Error::new).boxed())
                })
                .await
                .map_err(unavailable)?;
        }
    }
    if let Some(config) = configuration.agent {
        if let Some(faults) = agent_clock.injected_faults() {
            warn!(
                "CLOCK FAULT INJECTION: this agent's clocks are made wrong on purpose ({faults}); on a host in production remove the table [clock_fault]"
            );
        }
        lifecycle
            .start("agent", async |stop| {
                let running = Agent::start(config, VERSION, agent_clock, stop).await?;
                Ok(running.join().map_err(anyhow::Error::new).boxed())
            })
            .await
            .map_err(unavailable)?;
    }
    info!("ready");
    Ok(lifecycle.run().await)
}
