//! Recognition of figure files by their names.

use std::fs::{File, read_dir};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use peernet_logger::csv::column_name;

use crate::quality::Quality;

/// Histograms of the paper's original program, each as the name of its file without ending, its column and its title.
pub const HISTOGRAMS: [(&str, &str, &str); 6] = [
    ("sensing-time", "sensing", "Sensing time"),
    ("upload-time", "upload", "Upload time"),
    ("inference-time", "inference", "Inference time"),
    ("download-time", "download", "Download time"),
    ("upload-throughput", "upload-throughput", "Upload throughput"),
    ("download-throughput", "download-throughput", "Download throughput"),
];

/// Endings of the names of a figure's files. The caption's file is not `STEM.txt`, because this is the name of the
/// table with the same stem.
pub const FILE_ENDINGS: [&str; 4] = [".png", ".svg", ".pdf", "-caption.txt"];
/// Names of figures of which there is at most one, without the figures of [`Quality`].
const SINGLE_FIGURES: [&str; 5] = ["cumulative", "series", "length", "stacked", "paired"];
/// Names of figures of which there may be several. The names from the second figure on end with a number, such as
/// `totals-2`.
const NUMBERED_FIGURES: [&str; 4] = ["payload-latency", "payload-throughput", "totals", "users"];
/// Maximum number of bytes of `data.csv` that are read to find the end of its header.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// Returns the names of the files in a result folder that are figures of the results, or captions
/// of these figures.
// A file is recognised by its exact name, because figures of earlier results are removed, and files that a person added
// must stay.
pub fn figure_files(dir: &Path) -> Vec<String> {
    let columns = columns(&dir.join("data.csv"));
    let entries = read_dir(dir).into_iter().flatten().filter_map(Result::ok);
    let files = entries.filter(|entry| entry.file_type().is_ok_and(|kind| !kind.is_dir()));
    let names = files.filter_map(|entry| entry.file_name().into_string().ok());
    names.filter(|name| is_figure(name, &columns)).collect()
}

fn is_figure(name: &str, columns: &[String]) -> bool {
    let Some(stem) = FILE_ENDINGS.iter().find_map(|ending| name.strip_suffix(ending)) else { return false };
    let is_numbered = || {
        let suffix = NUMBERED_FIGURES.iter().find_map(|figure| stem.strip_prefix(figure));
        suffix.is_some_and(|suffix| {
            suffix.is_empty() || suffix.strip_prefix('-').is_some_and(|number| number.parse::<u32>().is_ok())
        })
    };
    let is_column = || {
        let column = stem.strip_suffix("-histogram").or_else(|| stem.strip_suffix("-cumulative"));
        column.is_some_and(|column| columns.iter().any(|other| other == column))
    };
    SINGLE_FIGURES.contains(&stem)
        || Quality::ALL.into_iter().any(|quality| quality.figure_stem() == stem)
        || HISTOGRAMS.iter().any(|(histogram, ..)| *histogram == stem)
        || is_numbered()
        || is_column()
}

/// Returns the names of the columns in `data.csv`, each of which may have a histogram. Empty if the file cannot be
/// read.
fn columns(data: &Path) -> Vec<String> {
    let header = || -> Option<String> {
        let file = data.is_file().then(|| File::open(data).ok())??;
        BufReader::new(file.take(MAX_HEADER_BYTES)).lines().next()?.ok()
    };
    let header = header().unwrap_or_default();
    header.split(',').map(|name| column_name(name.trim().trim_matches('"')).to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_figure_files_are_recognised() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("data.csv"), "iteration, inference_val,total\n1,2,3\n")
            .expect("writable");
        let figures = [
            "cumulative-caption.txt",
            "download-time.svg",
            "inference-histogram.png",
            "map-50.svg",
            "paired.svg",
            "payload-latency-3.png",
            "return-caption.txt",
            "stacked.pdf",
            "stacked.png",
            "total-cumulative.pdf",
            "total-histogram.png",
            "totals-2.pdf",
            "users-2.svg",
            "users.png",
        ];
        let others = [
            "my-histogram.png",
            "stacked.csv",
            "users.txt",
            "stacked-old.png",
            "users-photo.png",
            "notes.txt",
        ];
        for name in figures.iter().chain(&others) {
            std::fs::write(folder.path().join(name), "").expect("writable");
        }
        std::fs::create_dir(folder.path().join("series.png")).expect("writable");
        let mut found = figure_files(folder.path());
        found.sort();
        assert_eq!(found, figures);
    }
}
