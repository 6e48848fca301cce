//! Tests of interoperability with stamp-suite, as session-sender and as session-reflector.

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use peernet_clock::{ExchangeObservation, RelatedClocks, Span};
use peernet_probes::stamp::uncertainty;
use peernet_probes::{Key, ProbeResult, ReflectorConfig, TimestampSource};
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{
    MAX_WAIT, RunningProber, RunningReflector, prober_config, reflector_config, system_clock, wall_minus_raw,
};

fn stamp_suite() -> Command {
    let program = std::env::var_os("PEERNET_STAMP_SUITE").unwrap_or_else(|| "stamp-suite".into());
    let output = Command::new(&program).arg("--version").output();
    assert!(
        output.is_ok_and(|output| output.status.success()),
        "{} does not run: deploy/install-tools.sh test installs it, PEERNET_STAMP_SUITE names another place",
        program.display()
    );
    let mut command = Command::new(program);
    // The variable is removed, because stamp-suite would take its key from the variable.
    command.env_remove("STAMP_HMAC_KEY").env("RUST_LOG", "warn").stdin(Stdio::null());
    command
}

/// A key that both programs read from one file.
struct SharedKey {
    _folder: TempDir,
    path: PathBuf,
}

impl SharedKey {
    fn new() -> Self {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("probes.key");
        std::fs::write(&path, "5a".repeat(32)).expect("written");
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).expect("own file");
        Self { _folder: folder, path }
    }

    fn read_key(&self) -> Key {
        Key::read(&self.path).expect("a key")
    }

    fn add_arguments(&self, command: &mut Command) {
        command.args(["--auth-mode", "A", "--verify-tlv-hmac", "--hmac-key-file"]).arg(&self.path);
    }
}

/// A process that is killed when the test ends.
struct ForeignProcess(Child);

impl Drop for ForeignProcess {
    fn drop(&mut self) {
        // Killing fails if the process has already exited.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn number(summary: &Value, pointer: &str) -> f64 {
    summary.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("no {pointer} in {summary}"))
}

async fn run_foreign_sender(
    key: Option<&SharedKey>,
    stamps: TimestampSource,
    clock_format: &str,
    more_arguments: &[&str],
) -> Value {
    let config = ReflectorConfig { key: key.map(SharedKey::read_key), stamps, ..reflector_config() };
    let running = RunningReflector::start(config, system_clock("cloud"));
    let mut command = stamp_suite();
    command
        .args(["--remote-addr", "127.0.0.1", "--remote-port", &running.address.port().to_string()])
        .args(["--count", "20", "--send-delay", "10", "--timeout", "10", "--ssid", "4242"])
        .args(["--clock-source", clock_format, "--follow-up-telemetry", "--output-format", "json"])
        .args(more_arguments);
    if let Some(key) = key {
        key.add_arguments(&mut command);
    }
    let output = tokio::task::spawn_blocking(move || command.output())
        .await
        .expect("no panic")
        .expect("stamp-suite runs");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let counts = running.counters.read();
    assert_eq!(counts.answered, 20, "{counts:?}: {errors}");
    running.stop().await;
    let summary =
        text.lines().find(|line| line.contains("\"summary\"")).unwrap_or_else(|| panic!("{text}{errors}"));
    serde_json::from_str(summary).expect("JSON")
}

/// Checks the summary of the foreign sender after twenty probes over one clock.
fn assert_accepted(summary: &Value) {
    let measurements = "/measurements";
    assert_eq!(number(summary, "/packets_received"), 20.0, "{summary}");
    assert_eq!(number(summary, &format!("{measurements}/tlv_validation/rejected_replies")), 0.0, "{summary}");
    for flag in ["malformed", "integrity_failed"] {
        assert_eq!(number(summary, &format!("{measurements}/tlv_validation/flags/{flag}")), 0.0, "{summary}");
    }
    // With one clock, both directions take time, and no more than the round trip.
    let round_trip = number(summary, "/max_rtt_ms");
    for direction in ["forward", "reverse"] {
        let min_ms = number(summary, &format!("/owd/{direction}_min_ms"));
        let max_ms = number(summary, &format!("/owd/{direction}_max_ms"));
        assert!(
            min_ms >= 0.0 && max_ms <= round_trip,
            "{direction}: {min_ms} to {max_ms} of {round_trip} ms"
        );
    }
    // Each reply but the first has the follow-up of the reply before.
    assert_eq!(number(summary, &format!("{measurements}/follow_up/matched")), 19.0, "{summary}");
    assert!(number(summary, &format!("{measurements}/follow_up/reverse_delay/min_ms")) >= 0.0, "{summary}");
}

#[tokio::test]
async fn foreign_sender_accepts_our_replies() {
    for (stamps, format) in [(TimestampSource::Kernel, "NTP"), (TimestampSource::Program, "PTP")] {
        assert_accepted(&run_foreign_sender(None, stamps, format, &[]).await);
    }
}

#[tokio::test]
async fn foreign_authenticated_sender_accepts_our_replies() {
    let key = SharedKey::new();
    let summary =
        run_foreign_sender(Some(&key), TimestampSource::Kernel, "NTP", &["--extra-padding", "64"]).await;
    assert_accepted(&summary);
    assert_eq!(number(&summary, "/measurements/tlv_validation/hmac/verified"), 20.0, "{summary}");
}

#[tokio::test]
async fn foreign_sender_sees_unrecognized_tlvs_flagged() {
    let more_arguments = ["--direct-measurement", "--location", "--extra-padding", "200"];
    let summary = run_foreign_sender(None, TimestampSource::Kernel, "NTP", &more_arguments).await;
    assert_accepted(&summary);
    // In each of the twenty replies, two TLVs are unrecognized: direct measurement and location.
    assert_eq!(number(&summary, "/measurements/tlv_validation/flags/unrecognized"), 40.0, "{summary}");
}

async fn probe_foreign_reflector(
    address: &str,
    key: Option<&SharedKey>,
    more_arguments: &[&str],
) -> Vec<ProbeResult> {
    // A port outside the range from which the system assigns ports, on an address that only this test uses.
    let target = std::net::SocketAddr::new(address.parse().expect("an address"), 18_620);
    assert!(target.ip().is_loopback());
    let mut command = stamp_suite();
    command
        .args(["--is-reflector", "--local-addr", address, "--local-port", &target.port().to_string()])
        .args(more_arguments)
        .stdout(Stdio::null());
    if let Some(key) = key {
        key.add_arguments(&mut command);
    }
    let _foreign = ForeignProcess(command.spawn().expect("stamp-suite runs"));
    let mut config = prober_config(target);
    config.key = key.map(SharedKey::read_key);
    config.padding_bytes = 50;
    config.clocks = RelatedClocks::RawToWall;
    let mut probing = RunningProber::start(config, 100.0, system_clock("edge"));
    let mut results = Vec::new();
    let answered = async {
        while results.iter().filter(|result| matches!(result, ProbeResult::Answered(_))).count() < 30 {
            results.push(probing.next().await);
        }
    };
    tokio::time::timeout(MAX_WAIT, answered).await.expect("stamp-suite answers");
    probing.stop().await;
    results
}

fn assert_one_clock(observation: &ExchangeObservation) {
    let offset = wall_minus_raw(Span::ZERO);
    assert!(observation.exchange.bounds().intersection(offset).is_some(), "{observation:?} {offset:?}");
    assert_eq!(
        (observation.cloud_epoch, observation.exchange.uncertainty),
        (None, uncertainty::OTHER_IMPLEMENTATION)
    );
}

/// Checks that no probe is refused or lost. A probe need not be refined, because the foreign reflector's follow-up may
/// contain the same departure as the reply.
fn assert_nothing_lost(results: &[ProbeResult]) {
    for result in results {
        match result {
            ProbeResult::Answered(observation) | ProbeResult::Refined(observation) => {
                assert_one_clock(observation);
            }
            ProbeResult::Sent => {}
            other => panic!("{other:?}"),
        }
    }
}

#[tokio::test]
async fn foreign_reflector_answers_our_prober() {
    assert_nothing_lost(&probe_foreign_reflector("127.86.20.1", None, &["--stateful-reflector"]).await);
    assert_nothing_lost(&probe_foreign_reflector("127.86.20.2", None, &["--clock-source", "PTP"]).await);
    assert_nothing_lost(&probe_foreign_reflector("127.86.20.3", None, &["--tlv-mode", "ignore"]).await);
}

#[tokio::test]
async fn foreign_reflector_answers_our_authenticated_prober() {
    let key = SharedKey::new();
    assert_nothing_lost(&probe_foreign_reflector("127.86.20.4", Some(&key), &["--stateful-reflector"]).await);
}
