//! `peernet models list`: lists the models in the searched folders.

use crate::exit::Failure;
use crate::output::{print_to_stderr, print_to_stdout};
use peernet_analysis::table::text;
use peernet_inference::bank::ModelOnDisk;
use peernet_sample::printable_line;
use serde_json::{Value, json};

use super::SearchedFolders;

/// Arguments of `peernet models list`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    searched: SearchedFolders,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let folders = arguments.searched.folders()?;
    for error in folders.check() {
        print_to_stderr(error);
    }
    let models = folders.list();
    if arguments.json {
        print_to_stdout(Value::from_iter(models.iter().map(json_object)));
        return Ok(());
    }
    if models.is_empty() {
        let paths: Vec<String> = folders.paths().iter().map(|path| path.display().to_string()).collect();
        print_to_stdout(format_args!(
            "no model in {}; export one with models/export_torchvision.py, or name a folder with --models-dir",
            paths.join(", ")
        ));
        return Ok(());
    }
    let header = ["model", "task", "input", "size", "version", "folder", "wrong"];
    print_to_stdout(text(&header, &models.iter().map(row).collect::<Vec<_>>()));
    Ok(())
}

fn row(model: &ModelOnDisk) -> Vec<String> {
    let (task, input, version) = match &model.card {
        Ok(card) => (card.task.clone(), card.input.clone(), card.version.clone()),
        Err(_) => Default::default(),
    };
    let size =
        model.size().map(|bytes| peernet_statistics::number::bytes(bytes as f64).plain()).unwrap_or_default();
    let folder = model.folder.display().to_string();
    let cells =
        [model.name.to_string(), task, input, size, version, folder, problem(model).unwrap_or_default()];
    cells.map(|cell| printable_line(&cell).into_owned()).to_vec()
}

/// Returns the reason why the model cannot be used, if there is one.
fn problem(model: &ModelOnDisk) -> Option<String> {
    match (&model.card, &model.shadowed_by) {
        // Errors of the TOML parser have several lines.
        (Err(error), _) => Some(error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")),
        (Ok(_), Some(other)) => Some(format!("hidden by {}", other.display())),
        (Ok(_), None) => None,
    }
}

fn json_object(model: &ModelOnDisk) -> Value {
    json!({
        "model": model.name.to_string(),
        "folder": model.folder.display().to_string(),
        "bytes": model.size(),
        "card": model.card.as_ref().ok(),
        "wrong": problem(model),
    })
}

#[cfg(test)]
mod tests {
    use peernet_inference::bank::ModelFolders;

    use super::*;

    #[test]
    fn unreadable_model_is_listed_with_reason() {
        let models = tempfile::tempdir().expect("a folder");
        std::fs::create_dir(models.path().join("torn_card")).expect("made");
        std::fs::write(models.path().join("torn_card/model.toml"), "name = 'x'\ntask = 7\n")
            .expect("written");
        let listed = ModelFolders::new([models.path().to_owned()]).list();
        let row = row(&listed[0]);
        assert_eq!((row[0].as_str(), row.len()), ("torn_card", 7));
        assert!(row[6].contains("model.toml") && !row[6].contains('\n'), "{row:?}");
    }
}
