use peernet_external::exec::with_arguments;

use super::*;

fn read(text: &str) -> Result<ModelConfig, toml::de::Error> {
    toml::from_str(text)
}

#[test]
fn omitted_keys_have_defaults() {
    let onnx = read("name = \"q\"\nkind = \"onnx\"\npath = \"models/q\"").expect("reads");
    assert_eq!((onnx.device(), onnx.workers(), onnx.queue()), ("cpu", 1, 16));
    let ModelConfig::Sleep(sleep) = read("name = \"s\"\nkind = \"sleep\"").expect("reads") else {
        panic!("the kind of the model is not sleep");
    };
    let sleep = sleep.kind_settings;
    assert_eq!((sleep.preprocessing_ms, sleep.inference_ms, sleep.postprocessing_ms), (10, 80, 10));
}

#[test]
fn key_of_other_kind_and_misspelt_key_are_refused() {
    let error = read("name = \"e\"\nkind = \"echo\"\nworkers = 2").expect_err("echo has no workers");
    assert!(error.to_string().contains("workers"), "{error}");
    let error = read("name = \"q\"\nkind = \"onnx\"\npath = \"x\"\nworker = 2").expect_err("misspelt");
    assert!(error.to_string().contains("worker"), "{error}");
    assert!(read("name = \"q\"\nkind = \"onnx\"\npath = \"x\"\nworkers = 0").is_err());
}

#[test]
fn number_that_is_not_finite_is_named() {
    for (lines, named) in [
        ("'distribution'\nmean_ms = nan\nstd_ms = 1.0", "`mean_ms` is nan or inf; write a finite number"),
        ("'distribution'\nmean_ms = 1.0\nstd_ms = inf", "`std_ms` is nan or inf; write a finite number"),
        (
            "'distribution'\nhistogram = { edges_ms = [0.0, nan], counts = [1] }",
            "`histogram.edges_ms[1]` is nan or inf; write milliseconds from 0 to 86400000",
        ),
        ("'sleep'\ninference_ms = nan", "`inference_ms` is nan or inf"),
    ] {
        let error = read(&format!("name = 'm'\nkind = {lines}")).expect_err(named).to_string();
        assert!(error.contains(named), "{error}");
    }
}

#[test]
fn every_number_has_an_upper_limit() {
    for (kind, key, max) in [
        ("'onnx'\npath = 'x'", "workers", 256_u64),
        ("'onnx'\npath = 'x'", "queue", 65_536),
        ("'onnx'\npath = 'x'", "intra_threads", 1024),
        ("'onnx'\npath = 'x'", "inter_threads", 1024),
        ("'echo'", "answer_bytes", 1 << 30),
        ("'python'\nobject = 'a::b'", "workers", 256),
        ("'exec'\ncommand = 'x'", "queue", 65_536),
        ("'sleep'", "workers", 256),
        ("'sleep'", "queue", 65_536),
        ("'sleep'", "inference_ms", 86_400_000),
        ("'openai'\nurl = 'http://x'\nmodel = 'x'", "token_timeout_ms", 86_400_000),
        ("'distribution'", "workers", 256),
    ] {
        let check_with = |value| {
            let text = format!("name = 'm'\nkind = {kind}\n{key} = {value}");
            read(&text).expect("reads").check_limits()
        };
        assert!(check_with(max).is_ok(), "{key}");
        let error = check_with(max + 1).expect_err(key);
        assert!(matches!(error, LoadError::AboveLimit { key: k, .. } if k == key), "{error}");
        assert!(error.to_string().contains(&max.to_string()), "{error}");
    }
}

#[test]
fn unknown_key_error_lists_keys_of_kind() {
    for (kind, known) in [
        ("'echo'", "`name` or `answer_bytes`"),
        (
            "'sleep'",
            "one of `name`, `workers`, `queue`, `preprocessing_ms`, `inference_ms`, `postprocessing_ms`",
        ),
        (
            "'onnx'\npath = 'x'",
            "one of `name`, `device`, `workers`, `queue`, `path`, `intra_threads`, `inter_threads`",
        ),
        (
            "'exec'\ncommand = 'x'",
            "one of `name`, `device`, `workers`, `queue`, `command`, `timeout_ms`, `folder`, `env`",
        ),
        (
            "'python'\nobject = 'a::b'",
            "one of `name`, `device`, `workers`, `queue`, `object`, `folder`, `python`, `env`, `pickle`, `images`, \
             `timeout_ms`, `start_timeout_ms`",
        ),
        (
            "'openai'\nurl = 'http://x'\nmodel = 'x'",
            "one of `name`, `device`, `workers`, `queue`, `url`, `model`, `api_key_env`, `system_prompt`, `prompt`, \
             `first_token_timeout_ms`, `token_timeout_ms`, `timeout_ms`, `parameters`",
        ),
        (
            "'distribution'",
            "one of `name`, `device`, `workers`, `queue`, `data`, `column`, `mean_ms`, `std_ms`, `seed`, `inner`, \
             `histogram`",
        ),
    ] {
        let error = read(&format!("name = 'm'\nkind = {kind}\nzz = 1")).expect_err("has an unknown key");
        assert!(error.to_string().contains(&format!("unknown field `zz`, expected {known}")), "{error}");
    }
}

#[test]
fn table_is_written_with_keys_in_order() {
    for (text, written) in [
        ("kind = 'echo'\nname = 'm'", r#"{"kind":"echo","name":"m"}"#),
        (
            "kind = 'onnx'\nname = 'm'\npath = 'x'\nqueue = 3",
            r#"{"kind":"onnx","name":"m","device":"cpu","workers":1,"queue":3,"path":"x","intra_threads":1,"inter_threads":1}"#,
        ),
        (
            "kind = 'exec'\nname = 'm'\ncommand = ['x']",
            r#"{"kind":"exec","name":"m","device":"cpu","workers":1,"queue":16,"command":["x"]}"#,
        ),
        (
            "kind = 'distribution'\nname = 'm'\nseed = 2\n[histogram]\nedges_ms = [1.5, 2.0]\ncounts = [1]",
            r#"{"kind":"distribution","name":"m","device":"replayed","workers":1,"queue":16,"seed":2,"histogram":{"counts":[1],"edges_ms":[1.5,2.0]}}"#,
        ),
        (
            "kind = 'openai'\nname = 'm'\nurl = 'http://x'\nmodel = 'y'\nparameters = { seed = 1 }",
            r#"{"kind":"openai","name":"m","device":"server","workers":1,"queue":16,"url":"http://x","model":"y","first_token_timeout_ms":60000,"token_timeout_ms":10000,"timeout_ms":600000,"parameters":{"seed":1}}"#,
        ),
        (
            "kind = 'python'\nname = 'm'\nobject = 'a::b'\ntimeout_ms = 5",
            r#"{"kind":"python","name":"m","device":"cpu","workers":1,"queue":16,"object":"a::b","pickle":false,"images":"pil","timeout_ms":5}"#,
        ),
    ] {
        let config = read(text).expect("reads");
        let json = with_arguments(|| serde_json::to_string(&config)).expect("can be written");
        assert_eq!(json, written);
        assert_eq!(serde_json::from_str::<ModelConfig>(&json).expect("reads back"), config);
        let toml = with_arguments(|| toml::to_string(&config)).expect("can be written");
        assert_eq!(read(&toml).expect("reads back"), config);
    }
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct UnitConfig;

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EmptyConfig {}

macro_rules! keyless {
    ($($kind:ty),*) => { $(
        impl ModelKind for $kind {
            fn load(&self, _: &CommonSettings, _: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError> {
                // The tests never load these models, so any error will do.
                Err(LoadError::AboveLimit { key: "name", value: 1, max: 0 })
            }
        }
    )* };
}

keyless!(UnitConfig, EmptyConfig);

#[test]
fn kind_without_keys_is_read_and_written() {
    let (valid, invalid) = (r#"{"name":"m","device":"cpu","workers":1,"queue":2}"#, r#"{"name":"m","zz":1}"#);
    let unit: ModelTable<UnitConfig> = serde_json::from_str(valid).expect("reads");
    let empty: ModelTable<EmptyConfig> = serde_json::from_str(valid).expect("reads");
    assert_eq!(serde_json::to_string(&unit).expect("can be written"), valid);
    assert_eq!(serde_json::to_string(&empty).expect("can be written"), valid);
    assert!(serde_json::from_str::<ModelTable<UnitConfig>>(invalid).is_err());
    assert!(serde_json::from_str::<ModelTable<EmptyConfig>>(invalid).is_err());
}
