use peernet_agent::config::{LoadConfig, PlacementConfig};
use peernet_networks::Ros2SessionSettings;

use super::*;

const COMMON: &str = "\
[experiment]
name = 'e'
iterations = 10

[pipeline]
sensor = { kind = 'synthetic', size_bytes = 1000 }
placement = { kind = 'remote', peer = 'tcp://127.0.0.1:5551', model = 'echo' }
";

fn configurations(text: &str) -> anyhow::Result<Vec<Configuration>> {
    let file = File::parse(text.parse()?, Path::new("e.toml"))?;
    file.configurations(&[]).map(|(configurations, _)| configurations).map_err(|failure| failure.error)
}

fn read(more: &str) -> Vec<Configuration> {
    configurations(&format!("{COMMON}{more}")).expect("reads")
}

fn read_error(more: &str) -> String {
    configurations(&format!("{COMMON}{more}")).expect_err("something is wrong").to_string()
}

fn labels(configuration: &Configuration) -> String {
    configuration.labels.iter().map(|(_, label)| label.as_str()).collect::<Vec<_>>().join("/")
}

#[test]
fn model_folders_of_command_line_are_searched_first() {
    let folders = |more: &str| {
        let document = format!("{COMMON}{more}").parse().expect("TOML");
        let file = File::parse(document, Path::new("e.toml")).expect("is parsed");
        let (configurations, _) = file.configurations(&["/mine".into(), "/b".into()]).expect("reads");
        configurations[0].agent.bank.folders.clone()
    };
    let bank_folders = folders("[bank]\nfolders = ['/a', '/b']\n");
    assert_eq!(bank_folders, ["/mine", "/b", "/a"].map(std::path::PathBuf::from));
    assert_eq!(folders("")[..2], ["/mine", "/b"].map(std::path::PathBuf::from));
}

#[test]
fn file_without_axes_has_one_configuration() {
    let [only] = read("").try_into().expect("one");
    assert_eq!((only.labels.len(), only.users, only.warm_up.as_str()), (0, 1, "the first 5 iterations"));
    let pipeline = &only.agent.pipelines[0];
    assert_eq!((pipeline.name.as_str(), pipeline.limit.iterations.map(u64::from)), ("e", Some(10)));
}

#[test]
fn axes_multiply_and_last_changes_fastest() {
    let all = read(
        "[[axis]]\nname = 'Size'\nfield = 'pipeline.sensor.size_bytes'\nvalues = [1, 2]\n\
         [[axis]]\nname = 'Load'\n[[axis.value]]\nlabel = 'closed'\n[[axis.value]]\nlabel = '5 Hz'\n\
         set = { 'pipeline.load' = { mode = 'rate', hz = 5.0 }, 'experiment.users' = 3 }\n",
    );
    let combinations: Vec<String> = all.iter().map(labels).collect();
    assert_eq!(combinations, ["1/closed", "1/5 Hz", "2/closed", "2/5 Hz"]);
    assert_eq!(all.iter().map(|one| one.users).collect::<Vec<_>>(), [1, 3, 1, 3]);
    assert_eq!(all[0].agent.pipelines[0].load, LoadConfig::Closed {});
    assert_eq!(all[3].agent.pipelines[0].load, LoadConfig::Rate { hz: 5.0 });
    assert_ne!(all[0].agent.pipelines[0].sensor, all[2].agent.pipelines[0].sensor);
}

#[test]
fn exclusion_removes_configurations_with_all_its_labels() {
    let axes = "[[axis]]\nname = 'A'\nfield = 'pipeline.sensor.size_bytes'\nvalues = [1, 2, 3]\n\
                [[axis]]\nname = 'B'\nfield = 'pipeline.timeout_ms'\nvalues = [10, 20]\n";
    let with = |exclude: &str| {
        format!(
            "{}{axes}",
            COMMON.replace("iterations = 10", &format!("iterations = 10\nexclude = {exclude}"))
        )
    };
    let remaining = |exclude: &str| -> Vec<String> {
        configurations(&with(exclude)).expect("reads").iter().map(labels).collect()
    };
    assert_eq!(remaining("[{ A = 1, B = '20' }]"), ["1/10", "2/10", "2/20", "3/10", "3/20"]);
    assert_eq!(remaining("[{ A = [1, 2] }]"), ["3/10", "3/20"]);
    for (exclude, message) in [
        ("[{ C = 1 }]", "experiment.exclude[0]: there is no axis C, only A, B"),
        ("[{ A = 1 }, { A = 4 }]", "experiment.exclude[1]: A has no value 4, only 1, 2, 3"),
        ("[{}]", "names no axis"),
        ("[{ A = [1, 2, 3] }]", "it excludes all combinations"),
    ] {
        let error = configurations(&with(exclude)).expect_err(exclude).to_string();
        assert!(error.contains(message), "{error}");
    }
}

#[test]
fn mistake_is_reported_with_file_key_and_axis() {
    for (more, message) in [
        ("[serve]\n", "serve: an experiment has no such table"),
        ("[network]\nconfig = 'x'\nport = 1\n", "e.toml: network.port: unknown field"),
        (
            "[[axis]]\nname = 'A'\nfield = 'pipeline.placment.model'\nvalues = ['x']\n",
            "unknown field `placment`",
        ),
        (
            "[[axis]]\nname = 'A'\nfield = 'pipeline.placement.modle'\nvalues = ['x']\n",
            "e.toml: pipeline.placement: unknown field `modle`",
        ),
        ("[[axis]]\nname = 'A'\nfield = 'pipeline.placement.modle'\nvalues = ['x']\n", "(with A = x)"),
        (
            "[[axis]]\nname = 'A'\nfield = 'pipeline.timeout_ms.x'\nvalues = [1]\n",
            "pipeline.timeout_ms: invalid type: map",
        ),
        ("[[axis]]\nname = 'A'\nfield = 'pipeline.limit'\nvalues = ['x']\n", "use experiment.iterations"),
        (
            "[[axis]]\nname = 'A'\nfield = 'pipeline.timeout_ms'\nvalues = ['x']\n",
            "pipeline.timeout_ms: invalid type",
        ),
        (
            "[[axis]]\nname = 'A'\nfield = 'experiment.users'\nvalues = [0]\n",
            "experiment.users: invalid value",
        ),
        (
            "[spool]\nfile = 's'\n[[axis]]\nname = 'A'\nfield = 'experiment.users'\nvalues = [1, 2]\n",
            "experiment.users: several edges need one spool each, and get one if [spool] file is omitted (with A = 2)",
        ),
        ("[[axis]]\nfield = 'pipeline.timeout_ms'\nvalues = [1]\n", "missing field `name`"),
        ("[[axis]]\nname = 'A'\nfeld = 'x'\n", "axis[0].feld: unknown field"),
        (
            "[[axis]]\nname = 'count'\nfield = 'pipeline.timeout_ms'\nvalues = [1]\n",
            "tables of results already have a column named count",
        ),
    ] {
        let error = read_error(more);
        assert!(error.contains(message), "{message} is not in: {error}");
    }
    let placement = "[[axis]]\nname = 'A'\n[[axis.value]]\nlabel = 'x'\n\
                     set = { 'pipeline.placement' = { kind = 'local', model = 'm' } }\n";
    let model = "[[axis]]\nname = 'B'\nfield = 'pipeline.placement.model'\nvalues = ['n']\n";
    assert!(read_error(&format!("{model}{placement}")).contains("A overwrites what B sets"));
    let [both] = read(&format!("{placement}{model}")).try_into().expect("one");
    assert_eq!(
        both.agent.pipelines[0].placement,
        PlacementConfig::Local { model: "n".parse().expect("a name") }
    );
    let error = configurations("[pipeline]\n").expect_err("no experiment").to_string();
    assert!(error.contains("the table [experiment] is missing"), "{error}");
    let error =
        configurations("[experiment]\nname = 'e'\niterations = 1\n").expect_err("no pipeline").to_string();
    assert!(error.contains("the table [pipeline] is missing"), "{error}");
    assert!(configurations("[experiment\n").expect_err("no TOML").to_string().contains("line 1"));
}

#[test]
fn run_with_only_warm_up_is_refused() {
    let with = |limits: &str| configurations(&COMMON.replace("iterations = 10", limits));
    for limits in [
        "episodes = 1\nepisode_steps = 30",
        "episodes = 9\nepisode_steps = 1",
        "episodes = 2\nepisode_steps = 2\nwarm_up = { iterations = 4 }",
    ] {
        let error = with(limits).expect_err(limits).to_string();
        assert!(error.contains("experiment.warm_up: all iterations"), "{error}");
    }
    assert!(with("episodes = 2\nepisode_steps = 2").is_ok());
}

#[test]
fn only_feedback_can_end_run_after_episodes() {
    let limit = |actuator: &str| {
        let text = COMMON.replace("iterations = 10", "episodes = 3\nepisode_steps = 4");
        let [only] = configurations(&format!("{text}{actuator}")).expect("reads").try_into().expect("one");
        let limit = only.agent.pipelines[0].limit;
        (limit.total.map(u64::from), limit.episodes.map(u32::from))
    };
    let socket = "actuator = { kind = 'socket', address = 'udp://arm:9000', feedback = true }\n";
    assert_eq!(limit(socket), (Some(12), Some(3)));
    // The plan of such an experiment stays as earlier releases wrote it, so that it can be continued.
    for without_feedback in ["", "actuator = { kind = 'log' }\n", &socket.replace("true", "false")] {
        assert_eq!(limit(without_feedback), (Some(12), None), "{without_feedback}");
    }
}

#[test]
fn mistake_of_all_combinations_is_reported_once() {
    let error = read_error(
        "[bank]\nfolder = []\n[[axis]]\nname = 'A'\nfield = 'pipeline.timeout_ms'\nvalues = [1, 2, 3]\n",
    );
    assert_eq!(error.lines().count(), 1, "{error}");
}

#[test]
fn peer_can_be_device_of_published_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let net = folder.path().join("net.yaml");
    std::fs::write(&net, "devices:\n  cluster: 10.0.0.7\n  edge: 10.0.0.8\nstart_port: 6000\n")
        .expect("writable");
    let text =
        |peer: &str, network: &str| format!("{}{network}", COMMON.replace("tcp://127.0.0.1:5551", peer));
    let network = format!("[network]\nconfig = '{}'\n", net.display());
    let found = configurations(&text("cluster", &network)).expect("reads");
    let PlacementConfig::Remote(remote) = &found[0].agent.pipelines[0].placement else {
        panic!("it is remote")
    };
    assert_eq!(remote.peer.to_string(), "tcp://10.0.0.7:6000");
    let unknown = configurations(&text("desktop", &network)).expect_err("not there").to_string();
    assert!(unknown.contains("no device desktop, only cluster, edge"), "{unknown}");
    let nameless = configurations(&text("desktop", "")).expect_err("no names").to_string();
    assert!(
        nameless.contains("pipeline.placement.peer") && nameless.contains("[network] config"),
        "{nameless}"
    );
    let missing = configurations(&text("cluster", "[network]\nconfig = '/nowhere'\n"))
        .expect_err("no file")
        .to_string();
    assert!(missing.contains("network.config") && missing.contains("/nowhere"), "{missing}");
    assert!(!missing.contains("relative paths"), "{missing}");
    let elsewhere = configurations(&text("cluster", "[network]\nconfig = 'no/such.yaml'\n"))
        .expect_err("no file")
        .to_string();
    let here = std::env::current_dir().expect("a folder").display().to_string();
    assert!(elsewhere.contains("no/such.yaml") && elsewhere.contains(&here), "{elsewhere}");
}

#[test]
fn ros2_settings_of_devices_file_are_used() {
    let folder = tempfile::tempdir().expect("a folder");
    let net = folder.path().join("net.yaml");
    let write = |ros2: &str| {
        let text = format!("devices:\n  robot: ros2://7/gpu\n  cluster: 10.0.0.7\nros2: {ros2}\n");
        std::fs::write(&net, text).expect("writable");
    };
    let text = |peer: &str, own: &str| {
        let placement = COMMON.replace("tcp://127.0.0.1:5551'", &format!("{peer}'{own}"));
        format!("{placement}[network]\nconfig = '{}'\n", net.display())
    };
    let read = |text: &str| {
        let found = configurations(text).expect("reads");
        let PlacementConfig::Remote(remote) = &found[0].agent.pipelines[0].placement else {
            panic!("it is remote")
        };
        remote.session.ros2.clone()
    };
    write("{reliability: best-effort, depth: 3, deadline_ms: 40, interfaces: [lo]}");
    let expected = Ros2SessionSettings {
        reliability: serde_json::from_str("\"best-effort\"").expect("a reliability"),
        depth: 3,
        deadline_ms: Some(40),
        interfaces: vec!["lo".to_owned()],
    };
    assert_eq!(read(&text("robot", "")), expected);
    let own = ", session = { ros2 = { depth = 9 } }";
    let merged = Ros2SessionSettings { depth: 9, ..expected };
    assert_eq!(read(&text("robot", own)), merged);
    // Settings of ROS 2 are ignored on another network.
    assert_eq!(read(&text("cluster", "")), Ros2SessionSettings::default());
    write("{depht: 3}");
    let unknown = configurations(&text("robot", "")).expect_err("no such key").to_string();
    assert!(unknown.contains("network.config") && unknown.contains("depht"), "{unknown}");
}

#[test]
fn only_seeds_missing_in_file_are_set() {
    let seeds = |sensor: &str, load: &str| {
        let text = COMMON.replace("{ kind = 'synthetic', size_bytes = 1000 }", sensor);
        let text = text.replace("[pipeline]", &format!("[pipeline]\nload = {load}"));
        let seeds = configurations(&text).expect("reads")[0].seeds;
        (seeds.sensor, seeds.load)
    };
    let (unseeded_sensor, closed_load) = ("{ kind = 'text', length = 3 }", "{ mode = 'closed' }");
    assert_eq!(seeds(unseeded_sensor, closed_load), (true, false));
    assert_eq!(
        seeds("{ kind = 'text', length = 3, seed = 4 }", "{ mode = 'poisson', hz = 1.0 }"),
        (false, true)
    );
    assert_eq!(seeds(unseeded_sensor, "{ mode = 'poisson', hz = 1.0, seed = 2 }"), (true, false));
}

#[test]
fn huge_numbers_are_refused_with_key() {
    let error_with = |more: &str| {
        let text = COMMON.replace("iterations = 10", &format!("iterations = 10\n{more}"));
        configurations(&text).expect_err(more).to_string()
    };
    let error = error_with("repeats = 4000000000");
    assert!(error.contains("e.toml: experiment.repeats: the repeats make 4000000000 runs"), "{error}");
    assert!(error_with("users = 100000").contains("e.toml: experiment.users: 100000"));
    let error = read_error("[[axis]]\nname = 'P'\nfield = 'experiment.patience_s'\nvalues = [10, -1]\n");
    assert!(error.contains("experiment.patience_s: -1.0") && error.contains("(with P = -1)"), "{error}");
}
