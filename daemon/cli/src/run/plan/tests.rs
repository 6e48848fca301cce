use std::path::Path;

use peernet_sensors::SensorConfig;

use super::super::file::File;
use super::*;

const FILE: &str = "\
[experiment]
name = 'e'
seed = 7
repeats = 3
iterations = 10

[agent]
name = 'robot'

[pipeline]
sensor = { kind = 'text', length = 10 }
placement = { kind = 'none' }

[[axis]]
name = 'Time'
field = 'pipeline.timeout_ms'
values = [1, 2, 3, 4]

[[axis]]
name = 'Users'
field = 'experiment.users'
values = [1, 2]
";

fn plan(text: &str, seed: Option<u64>) -> Plan {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("e.toml");
    std::fs::write(&path, text).expect("writable");
    let file = File::read(Path::new(&path), &[]).expect("reads");
    Plan::new(&file.experiment, seed, file.configurations(&[]).expect("reads").0)
}

fn order(plan: &Plan) -> Vec<usize> {
    plan.runs.iter().map(|run| run.configuration).collect()
}

#[test]
fn order_follows_from_seed() {
    let first = plan(FILE, None);
    assert_eq!((first.runs.len(), order(&first)), (24, order(&plan(FILE, None))));
    assert_ne!(order(&first), order(&plan(FILE, Some(8))));
    let declared = plan(&FILE.replace("seed = 7", "order = 'declared'"), None);
    assert_eq!(order(&declared), (0..3).flat_map(|_| 0..8).collect::<Vec<_>>());
}

#[test]
fn each_repeat_is_block_of_all_configurations() {
    let plan = plan(FILE, None);
    for (repeat, block) in plan.runs.chunks(8).enumerate() {
        assert!(block.iter().all(|run| run.repeat as usize == repeat));
        let mut configurations: Vec<usize> = block.iter().map(|run| run.configuration).collect();
        configurations.sort_unstable();
        assert_eq!(configurations, (0..8).collect::<Vec<_>>());
    }
    assert_ne!(order(&plan)[..8], order(&plan)[8..16], "each block has an order of its own");
}

#[test]
fn folders_are_named_after_number_labels_and_repeat() {
    let declared = plan(&FILE.replace("seed = 7", "order = 'declared'"), None);
    assert_eq!(declared.runs[0].folder, "001-1-1-r1");
    assert_eq!(declared.runs[23].folder, "024-4-2-r3");
    let odd = FILE.replace(
        "name = 'Time'\nfield = 'pipeline.timeout_ms'\nvalues = [1, 2, 3, 4]",
        "name = 'Time'\n[[axis.value]]\nlabel = 'a/b ü../'",
    );
    assert_eq!(
        plan(&odd, None).runs[0].folder.split_once('-').map(|(_, rest)| &rest[..9]),
        Some("a-b--..--")
    );
}

#[test]
fn payloads_depend_on_seed_repeat_and_user_only() {
    let plan = plan(FILE, None);
    let seed = |run: &Run, user| match plan.pipeline(run, user, "id").expect("a pipeline").sensor {
        Some(SensorConfig::Text(text)) => text.seed,
        other => panic!("{other:?}"),
    };
    let run = |configuration, repeat| {
        let found = plan.runs.iter().find(|run| (run.configuration, run.repeat) == (configuration, repeat));
        found.expect("there is one")
    };
    assert_eq!(seed(run(0, 0), 0), seed(run(7, 0), 0));
    assert_ne!(seed(run(0, 0), 0), seed(run(0, 1), 0));
    assert_ne!(seed(run(1, 0), 0), seed(run(1, 0), 1));
    let other = super::tests::plan(FILE, Some(8));
    let Some(SensorConfig::Text(text)) = other.pipeline(&other.runs[0], 0, "id").expect("a pipeline").sensor
    else {
        panic!("it is a text")
    };
    let others = text.seed;
    assert_ne!(others, seed(run(other.runs[0].configuration, 0), 0));
    assert!(others < 1 << 53);
}

#[test]
fn run_is_labelled_with_experiment_configuration_and_repeat() {
    let plan = plan(FILE, None);
    let run = plan.runs.iter().find(|run| run.configuration == 3 && run.repeat == 1).expect("there is one");
    let experiment =
        plan.pipeline(run, 1, "abc").and_then(|pipeline| pipeline.experiment).expect("it has one");
    assert_eq!((experiment.name.as_str(), experiment.id.as_str(), experiment.repeat), ("e", "abc", 1));
    assert_eq!(describe_labels(&experiment.configuration), "Time = 2, Users = 2");
    assert_eq!(plan.describe(run), "Time = 2, Users = 2, repeat 2");
    let names = [0, 1].map(|user| plan.agent_name(run, user).map(|name| name.to_string()));
    assert_eq!(names, [Some("robot-1".to_owned()), Some("robot-2".to_owned())]);
    let alone = plan.runs.iter().find(|run| run.configuration == 2).expect("there is one");
    assert_eq!(plan.agent_name(alone, 0).map(|name| name.to_string()), Some("robot".to_owned()));
}

#[test]
fn users_are_numbered_after_machine_name() {
    let plan = plan(&FILE.replace("name = 'robot'", ""), None);
    let run = |configuration| plan.runs.iter().find(|run| run.configuration == configuration).expect("it is");
    let machine = plan.configurations[0].agent.agent.host_name().expect("the machine has a name");
    let name = |configuration, user| plan.agent_name(run(configuration), user).map(|name| name.to_string());
    assert_eq!(name(3, 1), Some(format!("{machine}-2")));
    assert_eq!(name(2, 0), None, "a single one takes the machine's");
}
