//! `peernet models show`: shows a model's card and the hash of its file.

use crate::exit::Failure;
use crate::output::print_to_stdout;
use peernet_sample::printable_line;
use peernet_statistics::number;
use serde_json::json;

use super::{WantedModel, describe_hash_mismatch, failure};

/// Maximum number of labels that are shown.
const MAX_LABELS: usize = 8;

/// Arguments of `peernet models show`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    model: WantedModel,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let model = arguments.model.find()?;
    let hash = model.hash().map_err(failure)?;
    let size = model.size().unwrap_or_default();
    let (name, folder) = (model.name, model.folder);
    let card = model.card.map_err(failure)?;
    let mismatch = describe_hash_mismatch(&card, &hash);
    if arguments.json {
        print_to_stdout(
            json!({ "model": name.to_string(), "folder": folder.display().to_string(), "bytes": size, "sha256": hash, "card": card }),
        );
        return Ok(());
    }
    let shown_labels: Vec<&str> = card.labels.iter().take(MAX_LABELS).map(String::as_str).collect();
    let more = if card.labels.len() > MAX_LABELS { ", …" } else { "" };
    let mut lines = vec![
        ("model".to_owned(), name.to_string()),
        ("folder".to_owned(), printable_line(&folder.display().to_string()).into_owned()),
        ("name".to_owned(), format!("{} {}", card.name, card.version)),
        ("what it does".to_owned(), card.description),
        ("task".to_owned(), card.task),
        ("input".to_owned(), card.input),
    ];
    lines.extend(card.preprocessing.into_iter().map(|step| ("  then".to_owned(), step)));
    lines.extend([
        ("output".to_owned(), card.output),
        ("labels".to_owned(), format!("{}{more}", shown_labels.join(", "))),
        ("model.onnx".to_owned(), number::bytes(size as f64).plain()),
        ("SHA-256".to_owned(), hash),
    ]);
    // The hash of the card is shown only if it does not match.
    lines.extend(card.provenance.into_iter().filter(|(key, _)| key != "sha256").map(explain_value));
    lines.extend(mismatch.map(|text| ("warning".to_owned(), text)));
    for (key, value) in lines.iter().filter(|(_, value)| !value.trim().is_empty()) {
        let value = value.lines().map(str::trim).collect::<Vec<_>>().join(" ");
        print_to_stdout(format_args!("{:<14}{}", printable_line(key), printable_line(value.trim())));
    }
    Ok(())
}

/// Explains the accuracy in the card: which share of which samples it is. Other values stay unchanged.
fn explain_value((key, value): (String, String)) -> (String, String) {
    if key != "accuracy" {
        return (key, value);
    }
    (key, format!("{value} of held-out samples are classified correctly, according to the card"))
}
