//! Tests of the check of configurations.

use peernet_agent::{Agent, AgentConfig};

use crate::harness::{clock, config};

fn problems(config: &AgentConfig) -> Vec<String> {
    Agent::check(config, &clock("system")).iter().map(ToString::to_string).collect()
}

#[test]
fn valid_configuration_has_no_problems_and_reads_back() {
    let state = tempfile::tempdir().expect("a folder");
    let mut valid = config(
        "[serve]\nlisten = 'tcp://127.0.0.1:0'\n[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = 'line'\nsensor = { kind = 'synthetic', sizes_bytes = [1, 2] }\n\
         placement = { kind = 'remote', peer = 'tcp://cloud:5551', network = 'zmq-tcp', model = 'm', device = 'cuda:0' }\n\
         load = { mode = 'poisson', hz = 5.0, seed = 3 }\nmax_in_flight = 2\ntimeout_ms = 100\n\
         warm_up = { iterations = 5, episodes = 1, steps = 2 }\nepisode_steps = 10\n\
         limit = { iterations = 7, duration_s = 1.5, episodes = 9 }\n\
         actuator = { kind = 'socket', address = 'tcp://arm:9000', feedback = true }\nstart = 'manual'\n\
         [spool]\nlimit_bytes = 1048576\nsync_interval_ms = 1\ncompression = 'always'\n",
    );
    valid.agent.state_dir = state.path().join("new").join("er");
    assert_eq!(problems(&valid), Vec::<String>::new());
    let written = toml::to_string(&valid).expect("can be written");
    assert_eq!(toml::from_str::<AgentConfig>(&written).expect("reads back"), valid);
}

#[test]
fn all_problems_are_listed_with_key_and_remedy() {
    let state = tempfile::tempdir().expect("a folder");
    std::fs::write(state.path().join("host-id"), "junk").expect("written");
    let mut invalid = config(
        "[serve]\nlisten = 'tcp://192.0.2.1:5551'\nsession = { max_in_flight = 0 }\n\
         [[model]]\nname = 'echo'\nkind = 'echo'\n[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = 'line'\nsensor = { kind = 'images', path = '/nowhere' }\n\
         placement = { kind = 'local', model = 'ecco' }\nload = { mode = 'rate', hz = 1e-300 }\n\
         warm_up = { steps = 1 }\nlimit = { duration_s = -1.0, episodes = 2 }\n\
         [[pipeline]]\nname = 'line'\nsensor = { kind = 'synthetic', size_bytes = 1 }\n\
         placement = { kind = 'local', model = 'echo' }\n\
         actuator = { kind = 'socket', address = 'udp://arm:9000', timeout_ms = 86400001 }\n\
         [bank]\nfolders = ['/nowhere/models']\n",
    );
    invalid.agent.state_dir = state.path().to_owned();
    let found = problems(&invalid);
    for expected in [
        "agent.state_dir: ",
        "model[1]: two models are named echo",
        "serve.listen: cannot listen on tcp://192.0.2.1:5551",
        "serve.session.max_in_flight: 0 must be between",
        "pipeline[0].sensor: cannot read /nowhere",
        "pipeline[0].placement.model: no model is named ecco; this host has echo",
        "pipeline[0].load.hz: 1e-300 is not a rate",
        "pipeline[0].limit.duration_s: -1.0 is not",
        "pipeline[0].limit.episodes: episodes needs episode_steps",
        "pipeline[1].actuator: timeout_ms = 86400001 is above",
        "pipeline[0].warm_up: ",
        "pipeline[1].name: another pipeline is named line",
    ] {
        assert!(found.iter().any(|problem| problem.starts_with(expected)), "{expected} in {found:#?}");
    }
    let searched = "; looked in the tables [[model]] and in the folders /nowhere/models";
    assert!(found.iter().any(|problem| problem.ends_with(searched)), "{found:#?}");
    assert_eq!(found.len(), 12, "{found:#?}");
}

#[test]
fn excessive_numbers_are_refused_with_limit() {
    let state = tempfile::tempdir().expect("a folder");
    let mut excessive = config(
        "[agent]\nio_threads = 65\nqueue_events = 1000000000000\nqueue_bytes = 1000000000000000\nbatch_nodes = 1000000000\n\
         batch_bytes = 1000000000\nbatch_delay_ms = 4000000000\nstop_timeout_ms = 60001\n\
         [spool]\nlimit_bytes = 1000000000000000\nsync_interval_ms = 4000000000\n\
         [[model]]\nname = 'echo'\nkind = 'echo'\nanswer_bytes = 1000000000000000\n\
         [[model]]\nname = 'crowd'\nkind = 'sleep'\nworkers = 1000000\n\
         [[model]]\nname = 'long'\nkind = 'sleep'\nqueue = 1000000000000000\n\
         [[pipeline]]\nname = 'line'\nsensor = { kind = 'synthetic', size_bytes = 1 }\n\
         placement = { kind = 'local', model = 'echo' }\nmax_in_flight = 1000000000000\ntimeout_ms = 86400001\n\
         limit = { duration_s = 1e308 }\n",
    );
    excessive.agent.state_dir = state.path().to_owned();
    let found = problems(&excessive);
    for (key, max) in [
        ("agent.io_threads", "64"),
        ("agent.queue_events", "10000000"),
        ("agent.queue_bytes", "17179869184"),
        ("agent.batch_nodes", "1000000"),
        ("agent.batch_bytes", "2097152"),
        ("agent.batch_delay_ms", "60000"),
        ("agent.stop_timeout_ms", "60000"),
        ("spool.limit_bytes", "1099511627776"),
        ("spool.sync_interval_ms", "60000"),
        ("model[0].answer_bytes", "1073741824"),
        ("model[1].workers", "256"),
        ("model[2].queue", "65536"),
        ("pipeline[0].max_in_flight", "4096"),
        ("pipeline[0].timeout_ms", "86400000"),
        ("pipeline[0].limit.duration_s", "31536000"),
    ] {
        let limit = format!("at most {max}");
        let has_limit =
            |problem: &String| problem.starts_with(&format!("{key}: ")) && problem.ends_with(&limit);
        assert!(found.iter().any(has_limit), "{key} {max} in {found:#?}");
    }
    assert_eq!(found.len(), 15, "{found:#?}");
}

#[test]
fn deadline_after_timeout_is_refused() {
    let state = tempfile::tempdir().expect("a folder");
    let problems_with = |deadline_ms: u64| {
        let mut config = config(&format!(
            "[[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 1 }}\n\
             placement = {{ kind = 'none' }}\ntimeout_ms = 200\ndeadline_ms = {deadline_ms}\n"
        ));
        config.agent.state_dir = state.path().to_owned();
        problems(&config)
    };
    assert_eq!(problems_with(200), [] as [&str; 0]);
    let found = problems_with(201);
    assert!(found.len() == 1 && found[0].starts_with("pipeline[0].deadline_ms: 201 is later"), "{found:?}");
}

#[test]
fn more_pipelines_than_maximum_are_refused() {
    let state = tempfile::tempdir().expect("a folder");
    let problems_with = |count: u32| {
        let pipeline = |number| {
            format!(
                "[[pipeline]]\nname = 'p{number}'\nsensor = {{ kind = 'synthetic', size_bytes = 1 }}\n\
                 placement = {{ kind = 'none' }}\n"
            )
        };
        let mut config = config(&(0..count).map(pipeline).collect::<String>());
        config.agent.state_dir = state.path().to_owned();
        problems(&config)
    };
    assert_eq!(problems_with(256), Vec::<String>::new());
    assert_eq!(problems_with(257), ["pipeline: 257 is too large; at most 256"]);
}

#[test]
fn unusable_spool_is_named_with_remedy() {
    let state = tempfile::tempdir().expect("a folder");
    let problems_with = |keys: &str| {
        let mut config = config(&format!("[agent]\nbatch_bytes = 1000000\n[spool]\n{keys}"));
        config.agent.state_dir = state.path().to_owned();
        problems(&config)
    };
    std::fs::write(state.path().join("file"), b"").expect("written");
    let folder = state.path().display();
    for (keys, expected) in [
        ("limit_bytes = 1048575".to_owned(), "spool.limit_bytes: 1048575 is too small; at least 1048576"),
        (
            "limit_bytes = 3999999".to_owned(),
            "spool.limit_bytes: 3999999 is too small: the spool must have space for four batches, 4000000 bytes",
        ),
        (format!("file = '{folder}'"), "is a folder; name a file"),
        (format!("file = '{folder}/file/spool.sqlite'"), "file is not a folder; choose another spool file"),
    ] {
        let found = problems_with(&keys);
        assert!(found.len() == 1 && found[0].contains(expected), "{expected} in {found:?}");
        assert!(found[0].starts_with("spool."), "{found:?}");
    }
    assert_eq!(
        problems_with(&format!("limit_bytes = 4000000\nfile = '{folder}/new/spool.sqlite'")),
        Vec::<String>::new()
    );
}

#[test]
fn unknown_keys_are_refused_by_name() {
    let pipeline = "[[pipeline]]\nname = 'l'\nsensor = { kind = 'synthetic', size_bytes = 1 }\n";
    for (tables, key) in [
        ("[agent]\nnam = 'x'".to_owned(), "nam"),
        ("[serve]\nport = 1".to_owned(), "port"),
        ("[spool]\nsize = 1".to_owned(), "size"),
        (format!("{pipeline}placement = {{ kind = 'local', model = 'm', peer = 'x' }}"), "peer"),
        (
            format!(
                "{pipeline}placement = {{ kind = 'local', model = 'm' }}\nload = {{ mode = 'closed', hz = 1.0 }}"
            ),
            "hz",
        ),
        (format!("{pipeline}placement = {{ kind = 'local', model = 'm' }}\nrate = 3"), "rate"),
    ] {
        let error = toml::from_str::<AgentConfig>(&tables).expect_err("has an unknown key").to_string();
        assert!(error.contains(&format!("`{key}`")), "{error}");
    }
}

#[test]
fn actuator_of_pipeline_that_only_senses_is_refused() {
    let state = tempfile::tempdir().expect("a folder");
    let mut without_model = config(
        "[[pipeline]]\nname = 'line'\nsensor = { kind = 'text', length = 10 }\nplacement = { kind = 'none' }\n\
         limit = { total = 5 }\nactuator = { kind = 'log' }\n\
         [[pipeline]]\nname = 'more'\nsensor = { kind = 'exec', command = ['./no-such-program'] }\n\
         placement = { kind = 'none' }\nlimit = { total = 6 }\nactuator = { kind = 'none' }\n",
    );
    without_model.agent.state_dir = state.path().to_owned();
    let found = problems(&without_model);
    assert_eq!(found.len(), 2, "{found:#?}");
    assert!(found[0].starts_with("pipeline[0].actuator: a pipeline that only senses"), "{found:#?}");
    assert!(
        found[1].starts_with("pipeline[1].sensor: ") && found[1].contains("no-such-program"),
        "{found:#?}"
    );
    let remarks: Vec<_> =
        Agent::remarks(&without_model, &clock("system")).iter().map(ToString::to_string).collect();
    assert_eq!(remarks.len(), 1, "{remarks:#?}");
    assert!(remarks[0].starts_with("pipeline[0].limit.total: all 5 iterations are warm-up"), "{remarks:#?}");
}

#[test]
fn missing_onnx_runtime_of_bank_is_remark() {
    let models = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models");
    let remarks = |bank: &str| -> Vec<String> {
        let text = format!("[agent]\nname = 'cloud'\n[onnxruntime]\nlibrary = '/nowhere/lib.so'\n{bank}");
        let config: peernet_agent::AgentConfig = toml::from_str(&text).expect("a configuration");
        Agent::remarks(&config, &clock("system")).iter().map(ToString::to_string).collect()
    };
    let found = remarks(&format!("[bank]\nfolders = ['{models}']"));
    assert_eq!(found.len(), 1, "{found:#?}");
    assert!(found[0].starts_with("onnxruntime: the models of [bank] cannot be loaded: "), "{found:#?}");
    assert!(found[0].contains("/nowhere/lib.so"), "{found:#?}");
    // Without a model the library is not needed.
    assert!(remarks("[bank]\nfolders = ['/nowhere/models']").is_empty());
}
