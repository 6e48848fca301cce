//! A model's settings as facts of a run. With these facts, another host can offer the same model.

use peernet_external::environment;
use peernet_external::exec::FingerprintKey;
use serde_json::Value;

use super::{ModelConfig, Table};

/// Keys of common settings that are recorded elsewhere in a run's description.
const RECORDED_ELSEWHERE: [&str; 2] = ["name", "device"];
/// Key of the environment variables of custom code.
const ENVIRONMENT: &str = "env";

impl ModelConfig {
    /// Returns facts: the settings of the model, the fingerprint of its arguments if there are any and a key is given,
    /// and the recorded environment variables, which custom code inherits.
    pub(crate) fn facts(&self, fingerprint_key: Option<&FingerprintKey>) -> Vec<(String, String)> {
        let mut facts = vec![("Model settings".to_owned(), self.settings())];
        facts.extend(fingerprint_key.and_then(|key| self.kind_settings().arguments_fact(key)));
        facts.extend(environment().into_iter().map(|(name, value)| (format!("Model {name}"), value)));
        facts
    }

    /// Returns those keys and values of the model's table that a run records, including defaults: `kind = onnx, workers
    /// = 2, …`.
    fn settings(&self) -> String {
        let table = serde_json::to_value(self).unwrap_or_default();
        let omitted = [&RECORDED_ELSEWHERE, self.kind_settings().keys_omitted_from_runs()].concat();
        let keys = table.as_object().into_iter().flatten();
        let entry = |(key, value): (&String, &Value)| match value {
            _ if omitted.contains(&key.as_str()) => None,
            // Values of environment variables may be secret, so only the names are recorded.
            Value::Object(variables) if key == ENVIRONMENT => {
                let names: Vec<&str> = variables.keys().map(String::as_str).collect();
                Some(format!("{key} with {}", names.join(" ")))
            }
            Value::String(text) => Some(format!("{key} = {text}")),
            value => Some(format!("{key} = {value}")),
        };
        keys.filter_map(entry).collect::<Vec<_>>().join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> String {
        toml::from_str::<ModelConfig>(text).expect("a model").settings()
    }

    #[test]
    fn settings_are_recorded_without_folders_and_secrets() {
        let text = settings("kind = 'sleep'\nname = 's'\ninference_ms = 3\nworkers = 2");
        for expected in
            ["kind = sleep", "inference_ms = 3", "preprocessing_ms = 10", "workers = 2", "queue = 16"]
        {
            assert!(text.split(", ").any(|key| key == expected), "{text}");
        }
        let text = settings(
            "kind = 'python'\nname = 'p'\nobject = 'a::B'\nfolder = '/home/me'\nenv = { TOKEN = 'secret' }",
        );
        assert!(text.contains("env with TOKEN") && text.contains("images = pil"), "{text}");
        assert!(!text.contains("secret") && !text.contains("/home/me"), "{text}");
        let text = settings(
            "kind = 'distribution'\nname = 'd'\nhistogram = { edges_ms = [1.0, 2.0], counts = [3] }",
        );
        assert!(text.contains("histogram = {\"counts\":[3],\"edges_ms\":[1.0,2.0]}, "), "{text}");
    }
}
