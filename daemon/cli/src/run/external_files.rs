//! Settings of an experiment's file that are not in its plan, so that they may change while the experiment lasts.

use peernet_analysis::record::{NetworkConfig, RunRecord};

use super::plan::Run;

/// Settings of an experiment's file that the plan does not contain: whether figures are drawn, and the external files
/// of devices, which the experiment's file only names.
pub(super) struct ExternalFiles {
    /// `true` if each run draws its figures.
    pub(super) plots: bool,
    /// File of devices of each configuration. The plan contains the addresses instead of the devices' names.
    pub(super) networks: Vec<Option<NetworkConfig>>,
}

impl ExternalFiles {
    /// Returns the file that names a run's peer.
    pub(super) fn network(&self, run: &Run) -> Option<&NetworkConfig> {
        self.networks.get(run.configuration)?.as_ref()
    }

    /// Returns a note if the file that names a run's peer had another text when the run was measured.
    pub(super) fn change_note(&self, run_record: &RunRecord, run: &Run) -> Option<String> {
        let (current, recorded) = (self.network(run)?, run_record.network_config.as_ref()?);
        (current.text != recorded.text).then(|| {
            format!(
                "{} has changed since some runs were measured, but the addresses that these runs use are unchanged; run.json of each run contains the earlier text",
                current.file
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_changed_text_of_devices_file_is_reported() {
        let network =
            |file: &str, text: &str| Some(NetworkConfig { file: file.to_owned(), text: text.to_owned() });
        let external_files =
            ExternalFiles { plots: false, networks: vec![None, network("net.yaml", "devices: {a: b}")] };
        let run = |configuration| Run { number: 1, configuration, repeat: 0, folder: "001-r1".to_owned() };
        let message = |recorded: Option<NetworkConfig>, configuration| {
            let record = RunRecord { network_config: recorded, ..RunRecord::default() };
            external_files.change_note(&record, &run(configuration))
        };
        let text = message(network("net.yaml", "devices: {a: b, c: d}"), 1).expect("it has changed");
        assert!(text.starts_with("net.yaml has changed"), "{text}");
        assert_eq!(message(network("other.yaml", "devices: {a: b}"), 1), None);
        // An earlier version recorded no file, and a peer with an address needs none.
        assert_eq!((message(None, 1), message(network("net.yaml", "x"), 0)), (None, None));
    }
}
