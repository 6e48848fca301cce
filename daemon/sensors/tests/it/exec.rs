use peernet_external::exec::{CommandLine, ExecConfig};
use peernet_sensors::{SensorConfig, SensorKind};

use super::{real_clock, recorder};

fn config(command: &str) -> SensorConfig {
    SensorConfig::Exec(ExecConfig::new(CommandLine::Shell(command.to_owned())))
}

#[test]
fn program_provides_samples_labels_and_dropped_samples() {
    // The program numbers its samples 5, 6, 9 and, as after a restart, 1.
    let script = "for n in 5 6 9 1; do read -r next; \
                  printf 'sequence %d\\nlabel cat %d\\nsource n%d\\nvalue gain 2 dB\\nanswer 2 text/plain\\n%02d' $n $n $n $n; \
                  done; read -r next; echo end; cat";
    let mut sensor = config(script).open(&real_clock()).expect("sh is there");
    assert!(sensor.blocks());
    // A command may contain secrets, so facts name the program only.
    assert!(sensor.facts().iter().all(|(_, fact)| !fact.contains("for n in")), "{:?}", sensor.facts());
    for (number, dropped) in [(5, 0.0), (6, 0.0), (9, 2.0), (1, 0.0)] {
        let mut recorder = recorder();
        let sample = sensor.sample(&mut recorder).expect("no error").expect("a sample");
        assert_eq!((sample.source, sample.label), (format!("n{number}"), Some(format!("cat {number}"))));
        assert_eq!(sample.parts[0].bytes, format!("{number:02}"));
        let value = |name| recorder.tree().find(&[name]).and_then(|(_, node)| node.measure.value());
        assert_eq!((value("dropped-samples"), value("gain")), (Some(dropped), Some(2.0)));
        assert_eq!(value("capture-restart"), None);
    }
    let mut recorder = recorder();
    assert!(
        sensor.sample(&mut recorder).expect("the program ends without an error").is_none(),
        "there are no more samples"
    );
}

#[test]
fn program_is_reset_before_each_episode() {
    let script = "n=0; while read -r word; do n=$((n + 1)); \
                  if [ $word = reset ]; then n=0; echo done; else echo answer 1; printf $n; fi; done";
    let exec = ExecConfig { resets: true, ..ExecConfig::new(CommandLine::Shell(script.to_owned())) };
    let mut sensor = SensorConfig::Exec(exec).open(&real_clock()).expect("sh is there");
    assert!(sensor.resets());
    for (begins_episode, expected) in [(true, "1"), (false, "2"), (true, "1")] {
        if begins_episode {
            sensor.reset().expect("is reset");
        }
        let sample = sensor.sample(&mut recorder()).expect("no error").expect("a sample");
        assert_eq!(sample.parts[0].bytes, expected);
    }
}

#[test]
fn failure_names_program_and_next_sample_retries() {
    let folder = tempfile::tempdir().expect("can be made");
    let marker = folder.path().join("mark");
    let script =
        format!("if [ -e {0} ]; then read -r x; echo answer 0; cat; fi; touch {0}; exit 7", marker.display());
    let mut sensor = config(&script).open(&real_clock()).expect("sh is there");
    let mut recorder = recorder();
    let error = sensor.sample(&mut recorder).expect_err("it ends").to_string();
    assert!(error.contains("exit status 7") && error.contains("the program sh:"), "{error}");
    assert!(sensor.sample(&mut recorder).expect("the second process answers").is_some());
    assert!(recorder.tree().find(&["capture-restart"]).is_some(), "the restart is recorded");
}

#[test]
fn check_does_not_run_program() {
    let folder = tempfile::tempdir().expect("can be made");
    let marker = folder.path().join("mark");
    config(&format!("touch {}", marker.display())).check(&real_clock()).expect("is well formed");
    assert!(!marker.exists());
    let missing = ExecConfig::new(CommandLine::Words(vec!["./no-such-program".to_owned()]));
    let error = SensorConfig::Exec(missing).check(&real_clock()).expect_err("is not there").to_string();
    assert!(error.contains("./no-such-program"), "{error}");
}
