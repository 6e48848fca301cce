//! Models that ran at several places, such as on the robot and in the cloud. A place is a kind of placement and a
//! device.

use peernet_stream::PlacementKind;

/// Model of a run, and where it ran.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlacedModel {
    /// Name of the model; for a run without a model, the name of the run.
    pub model: String,
    /// Name of the kind of placement; empty if the kind is not known. An unknown kind counts as remote.
    pub kind: String,
    /// Device of the model; empty if it is not known.
    pub device: String,
}

/// Models that ran at several places, with these places.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ModelPlaces {
    /// Names of all places, the local places first. A name is the word for the kind of placement. The device follows if
    /// several places have this kind.
    pub places: Vec<String>,
    /// Each model with the indexes of its runs: one list of indexes for each of `places`, in the order of `places`.
    pub models: Vec<(String, Vec<Vec<usize>>)>,
    /// Models that ran at only one place. They are not in `models`, because there is nothing to compare them with.
    pub at_one_place: Vec<String>,
}

impl ModelPlaces {
    /// Groups runs by model and place.
    pub fn new(runs: &[PlacedModel]) -> Self {
        let place_of = |run: &PlacedModel| {
            let kind = if run.kind.is_empty() { PlacementKind::Remote.name() } else { &run.kind };
            (kind.to_owned(), run.device.clone())
        };
        let (mut names, mut places) = (Vec::new(), Vec::new());
        for run in runs {
            push_new(&mut names, run.model.clone());
            push_new(&mut places, place_of(run));
        }
        places.sort_by_key(|(kind, _)| kind != PlacementKind::Local.name());
        let runs_at = |model: &String, place: &(String, String)| {
            let matches = |index: &usize| runs[*index].model == *model && place_of(&runs[*index]) == *place;
            (0..runs.len()).filter(matches).collect::<Vec<_>>()
        };
        let model = |model: String| {
            let runs = places.iter().map(|place| runs_at(&model, place)).collect();
            (model, runs)
        };
        let models: Vec<(String, Vec<Vec<usize>>)> = names.into_iter().map(model).collect();
        let (compared, others): (Vec<_>, Vec<_>) = models.into_iter().partition(ran_at_several_places);
        let has_one_place = |kind: &str| places.iter().filter(|(other, _)| other == kind).count() == 1;
        let name = |(kind, device): &(String, String)| {
            let place = place_word(kind);
            if has_one_place(kind) || device.is_empty() {
                place.to_owned()
            } else {
                format!("{place}, {device}")
            }
        };
        let places = places.iter().map(name).collect();
        Self { places, models: compared, at_one_place: others.into_iter().map(|(model, _)| model).collect() }
    }
}

/// Returns the word for a kind of placement in tables and figures: `cloud` for `remote`, like the labels of
/// experiments.
pub fn place_word(kind: &str) -> &str {
    if kind == PlacementKind::Remote.name() { "cloud" } else { kind }
}

fn ran_at_several_places((_, runs): &(String, Vec<Vec<usize>>)) -> bool {
    runs.iter().filter(|runs| !runs.is_empty()).count() > 1
}

/// Appends an item unless the list has it.
fn push_new<T: PartialEq>(items: &mut Vec<T>, item: T) {
    if !items.contains(&item) {
        items.push(item);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(model: &str, kind: &str, device: &str) -> PlacedModel {
        PlacedModel { model: model.to_owned(), kind: kind.to_owned(), device: device.to_owned() }
    }

    #[test]
    fn runs_are_grouped_by_model_and_place() {
        let runs = [
            placed("s", "remote", "cpu"),
            placed("s", "local", "cpu"),
            placed("m", "remote", "cuda:0"),
            placed("s", "", "cpu"),
        ];
        let found = ModelPlaces::new(&runs);
        assert_eq!(found.places, ["local", "cloud, cpu", "cloud, cuda:0"]);
        assert_eq!(found.models, [("s".to_owned(), vec![vec![1], vec![0, 3], vec![]])]);
        assert_eq!(found.at_one_place, ["m"]);
    }

    #[test]
    fn models_at_only_one_place_are_listed_separately() {
        let found = ModelPlaces::new(&[placed("s", "local", "cpu"), placed("m", "remote", "cpu")]);
        assert_eq!(found.places, ["local", "cloud"]);
        assert!(found.models.is_empty() && found.at_one_place == ["s", "m"], "{found:?}");
        assert_eq!(ModelPlaces::new(&[]), ModelPlaces::default());
    }
}
