//! Load of other processes, containers and virtual machines on the processors.

use std::thread;
use std::time::Duration;

use peernet_stream::Grade;

use super::files::{list_entries, processors, read_text};
use super::{Finding, InspectionSettings};

/// Pause between two counts of the threads.
const COUNT_INTERVAL: Duration = Duration::from_millis(8);
/// Number of other runnable threads per processor from which the grade is doubtful: they disturb the run at times.
const COMPETING_DOUBTFUL: f64 = 0.25;
/// Number of other runnable threads per processor from which the grade is bad: the run shares every processor.
const COMPETING_BAD: f64 = 1.0;
/// Share of steal time since the start of the host from which the grade is doubtful.
const STEAL_DOUBTFUL: f64 = 0.01;
/// Share of steal time since the start of the host from which the grade is bad.
const STEAL_BAD: f64 = 0.05;

/// Grades the number of runnable threads of other processes: the mean of a few counts (proc_loadavg(5)).
// The load averages of the kernel are unsuitable: they still include processes that ended a minute ago, such as the
// previous run.
pub(super) fn competing_threads(settings: &InspectionSettings) -> Finding {
    const ABOUT: &str = "competing load";
    let mut sum = 0;
    let counting_rounds = settings.counting_rounds.max(1);
    for round in 0..counting_rounds {
        if round > 0 {
            thread::sleep(COUNT_INTERVAL);
        }
        let Some(running) = runnable_threads(settings) else {
            return Finding::unknown(ABOUT, "the kernel does not report the number of runnable threads");
        };
        // The two numbers are read one after the other, so the number of own threads may be the larger one.
        sum += running.saturating_sub(own_threads(settings));
    }
    let other_threads = f64::from(sum) / f64::from(counting_rounds);
    let cores = processors(&settings.sys).len().max(1) as f64;
    let pressure = pressure(settings).map_or_else(String::new, |percent| {
        format!("; in the last 10 s threads waited for a processor during {percent:.0} % of the time")
    });
    let found = format!("{other_threads:.1} other threads are runnable, on {cores:.0} processors{pressure}");
    let advice = "stop the other programs on this host, which `top` lists, and repeat the run";
    match other_threads / cores {
        per_core if per_core >= COMPETING_BAD => Finding::graded(ABOUT, Grade::Bad, found, advice),
        per_core if per_core >= COMPETING_DOUBTFUL => Finding::graded(ABOUT, Grade::Doubtful, found, advice),
        _ => Finding::good(ABOUT, found),
    }
}

/// Returns the number of runnable threads of the whole host.
fn runnable_threads(settings: &InspectionSettings) -> Option<u32> {
    let load = read_text(&settings.proc.join("loadavg"))?;
    // After the three load averages follow the numbers of runnable threads and of all threads: `2/813`.
    load.split_ascii_whitespace().nth(3)?.split_once('/')?.0.parse().ok()
}

/// Returns the number of runnable threads of this process (proc_pid_stat(5)).
fn own_threads(settings: &InspectionSettings) -> u32 {
    let threads = list_entries(&settings.proc.join("self/task"), "").into_iter();
    let is_runnable = |path: &std::path::PathBuf| {
        // The state follows the name in parentheses. The name itself may contain a parenthesis, so the text after the
        // last parenthesis is used.
        read_text(&path.join("stat")).is_some_and(|stat| {
            stat.rsplit(')').next().is_some_and(|rest| rest.trim_start().starts_with('R'))
        })
    };
    u32::try_from(threads.filter(is_runnable).count()).unwrap_or(u32::MAX)
}

/// Returns the percentage of the last 10 s in which some thread waited for a processor (kernel documentation,
/// accounting/psi).
fn pressure(settings: &InspectionSettings) -> Option<f64> {
    let pressure = read_text(&settings.proc.join("pressure/cpu"))?;
    let some_line = pressure.lines().find_map(|line| line.strip_prefix("some "))?;
    some_line.split_ascii_whitespace().find_map(|field| field.strip_prefix("avg10=")?.parse().ok())
}

/// Grades the CPU quota of a container (cgroup v2, `cpu.max`). When the quota is used up, the kernel stops the process
/// until the next period, which looks like a slow model. `None` without a quota.
pub(super) fn cpu_quota(settings: &InspectionSettings) -> Option<Finding> {
    let cgroups = read_text(&settings.proc.join("self/cgroup"))?;
    let path = cgroups.lines().find_map(|line| line.strip_prefix("0::"))?.trim_start_matches('/').to_owned();
    let max = read_text(&settings.sys.join("fs/cgroup").join(path).join("cpu.max"))?;
    // Without a quota the file contains `max 100000`, and parsing `max` as a number fails.
    let (quota, period) = max.split_once(' ')?;
    let (quota, period): (f64, f64) = (quota.parse().ok()?, period.parse().ok()?);
    (period > 0.0).then(|| {
        Finding::graded(
            "CPU quota",
            Grade::Doubtful,
            format!(
                "this process may use {:.2} processors on average; when it has used its share of a period of {:.0} ms, \
                 it is stopped until the period ends",
                quota / period,
                period / 1e3
            ),
            "run the agent without a CPU limit",
        )
    })
}

/// Grades the steal time, during which the hypervisor ran other machines (proc_stat(5)); `None` if there was none.
pub(super) fn steal_time(settings: &InspectionSettings) -> Option<Finding> {
    let stat = read_text(&settings.proc.join("stat"))?;
    let times = stat.lines().find_map(|line| line.strip_prefix("cpu "))?;
    let times: Vec<u64> = times.split_ascii_whitespace().filter_map(|ticks| ticks.parse().ok()).collect();
    // Only the first eight times are added: the guest times that follow are included in the user times.
    let (steal, total) = (*times.get(7)?, times.iter().take(8).sum::<u64>());
    (steal > 0 && total > 0).then_some(())?;
    let share = steal as f64 / total as f64;
    let found = format!(
        "other virtual machines used the processors of this host for {:.1} % of the time since this host was started",
        share * 100.0
    );
    let advice = "measure on a dedicated machine, or on one with reserved processors";
    let about = "stolen time";
    Some(match share {
        share if share >= STEAL_BAD => Finding::graded(about, Grade::Bad, found, advice),
        share if share >= STEAL_DOUBTFUL => Finding::graded(about, Grade::Doubtful, found, advice),
        _ => Finding::good(about, found),
    })
}
