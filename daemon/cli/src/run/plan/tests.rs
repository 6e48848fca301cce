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
    let sensor = |plan: &Plan, run: &Run, user| plan.agent(run, user, "id").pipelines.remove(0).sensor;
    let seed = |run: &Run, user| match sensor(&plan, run, user) {
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
    let Some(SensorConfig::Text(text)) = sensor(&other, &other.runs[0], 0) else { panic!("it is a text") };
    let other_seed = text.seed;
    assert_ne!(other_seed, seed(run(other.runs[0].configuration, 0), 0));
    assert!(other_seed < 1 << 53, "an f64 represents the seed exactly");
}

const PROGRAMS: &str = "\
[experiment]
name = 'e'
seed = 7
repeats = 2
users = 2
iterations = 10

[pipeline]
sensor = { kind = 'exec', command = 'true' }
placement = { kind = 'local', model = 'gpu' }
actuator = { kind = 'python', object = 'a::b', env = { PEERNET_SEED = '5' } }

[[model]]
name = 'gpu'
kind = 'distribution'
mean_ms = 1.0
std_ms = 0.5
inner = 'own'

[[model]]
name = 'own'
kind = 'python'
object = 'a::c'

[[axis]]
name = 'Time'
field = 'pipeline.timeout_ms'
values = [1, 2]
";

/// Returns the three variables of sensor, actuator and model, and the seed of the draws.
fn variables_and_seed(plan: &Plan, run: &Run, user: u32) -> (Vec<Vec<String>>, u64) {
    let mut agent = plan.agent(run, user, "id");
    let mut pipeline = agent.pipelines.remove(0);
    let envs = [
        pipeline.sensor.as_mut().and_then(SensorKind::env_mut),
        pipeline.actuator.env_mut(),
        agent.models[1].env_mut(),
    ]
    .map(|env| env.expect("runs custom code").clone());
    let variables = |env: &BTreeMap<String, String>| {
        ["PEERNET_SEED", "PEERNET_REPEAT", "PEERNET_USER"].map(|name| env[name].clone()).to_vec()
    };
    let draw_seed = agent.models[0].seed_mut().copied().flatten().expect("has a seed");
    (envs.iter().map(variables).collect(), draw_seed)
}

#[test]
fn custom_code_seeds_depend_on_repeat_and_user_only() {
    let plan = plan(PROGRAMS, None);
    let find = |configuration, repeat| {
        let found = plan.runs.iter().find(|run| (run.configuration, run.repeat) == (configuration, repeat));
        found.expect("there is one")
    };
    let (first, draw_seed) = variables_and_seed(&plan, find(0, 0), 0);
    assert_eq!(
        variables_and_seed(&plan, find(1, 0), 0),
        (first.clone(), draw_seed),
        "configurations are compared on equal draws"
    );
    let seeds: Vec<&str> = first.iter().map(|variables| variables[0].as_str()).collect();
    assert_eq!(seeds[1], "5", "a value of the file stays");
    assert!(seeds[0] != seeds[2] && seeds[2] == draw_seed.to_string(), "{seeds:?}");
    for (run, user, numbers) in [(find(0, 1), 0, ["2", "1"]), (find(0, 0), 1, ["1", "2"])] {
        let (other, other_draw_seed) = variables_and_seed(&plan, run, user);
        assert!(
            other[0][0] != seeds[0] && other[2][0] != seeds[2] && other_draw_seed != draw_seed,
            "{other:?}"
        );
        assert!(other.iter().all(|variables| variables[1..] == numbers), "{other:?}");
    }
    let set = PROGRAMS.replace("std_ms = 0.5", "std_ms = 0.5\nseed = 3");
    let plan = super::tests::plan(&set, None);
    assert_eq!(variables_and_seed(&plan, &plan.runs[0], 0).1, 3);
}

#[test]
fn run_is_labelled_with_experiment_configuration_and_repeat() {
    let plan = plan(FILE, None);
    let run = plan.runs.iter().find(|run| run.configuration == 3 && run.repeat == 1).expect("there is one");
    let experiment = plan.agent(run, 1, "abc").pipelines.remove(0).experiment.expect("it has one");
    assert_eq!((experiment.name.as_str(), experiment.id.as_str(), experiment.repeat), ("e", "abc", 1));
    assert_eq!(describe_labels(&experiment.configuration, None), "Time = 2, Users = 2");
    assert_eq!(plan.describe(run), "Time = 2, Users = 2, repeat 2");
    let names = [0, 1].map(|user| plan.agent_name(run, user).map(|name| name.to_string()));
    assert_eq!(names, [Some("robot-1".to_owned()), Some("robot-2".to_owned())]);
    let alone = plan.runs.iter().find(|run| run.configuration == 2).expect("there is one");
    assert_eq!(plan.agent_name(alone, 0).map(|name| name.to_string()), Some("robot".to_owned()));
}

#[test]
fn users_are_named_by_machine_and_number() {
    let plan = plan(&FILE.replace("name = 'robot'", ""), None);
    let run = |configuration| {
        plan.runs.iter().find(|run| run.configuration == configuration).expect("the configuration has a run")
    };
    let machine = plan.configurations[0].agent.agent.host_name().expect("the machine has a name");
    let name = |configuration, user| plan.agent_name(run(configuration), user).map(|name| name.to_string());
    assert_eq!(name(3, 1), Some(format!("{machine}-2")));
    assert_eq!(name(2, 0), None, "a single user has the name of the machine");
}

#[test]
fn users_of_host_with_long_name_have_different_names() {
    let long_name = "r".repeat(Slug::MAX_CHARS);
    let plan = plan(&FILE.replace("name = 'robot'", &format!("name = '{long_name}'")), None);
    let run = plan.runs.iter().find(|run| run.configuration == 1).expect("the configuration has a run");
    let names = [0, 1].map(|user| plan.agent_name(run, user).map(|name| name.to_string()));
    let begin = "r".repeat(Slug::MAX_CHARS - 2);
    assert_eq!(names, [Some(format!("{begin}-1")), Some(format!("{begin}-2"))]);
}
