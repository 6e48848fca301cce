//! Figures of the calibration of a link.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::of_messages::{LinkMessages, MessageSeries};
use crate::render::export;
use peernet_analysis::WriteError;
use peernet_analysis::calibration::Study;
use peernet_analysis::figure_files::FILE_ENDINGS;

/// Draws the figures `latency` and `throughput` of a calibration into an existing folder, each as `.png`, `.svg`,
/// `.pdf` and `-caption.txt`. Returns the paths of the files. A figure without data is left out. Its files of an earlier
/// calibration are then removed, because they would look like a part of this calibration.
///
/// # Errors
/// If a file cannot be written or removed.
pub fn draw_calibration(study: &Study, folder: &Path) -> Result<Vec<PathBuf>, WriteError> {
    let messages = messages(study);
    let mut files = Vec::new();
    for (stem, figure) in [("latency", messages.latency()), ("throughput", messages.throughput())] {
        if figure.series.iter().any(|series| !series.values.is_empty()) {
            files.extend(export::write(&figure.figure(), folder, stem)?);
            continue;
        }
        for file in FILE_ENDINGS.map(|ending| folder.join(format!("{stem}{ending}"))) {
            match std::fs::remove_file(&file) {
                Err(error) if error.kind() != ErrorKind::NotFound => {
                    return Err(WriteError::at(&file)(error));
                }
                _ => {}
            }
        }
    }
    Ok(files)
}

/// Returns the messages of a calibration.
pub(crate) fn messages(study: &Study) -> LinkMessages {
    let directions = study.directions().into_iter();
    let directions =
        directions.map(|direction| MessageSeries::new(direction.name(), direction.sizes.clone())).collect();
    LinkMessages { link_name: String::new(), directions, notes: Vec::new() }
}

#[cfg(test)]
mod tests {
    use peernet_analysis::calibration::Passage;
    use peernet_analysis::calibration::{Sample, Setting};
    use peernet_analysis::rows::Outcome;
    use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict};

    use super::*;

    /// Returns the passage of a message that takes 60 µs plus 1 ns for each byte plus up to 6 µs. The bounds are 50 µs
    /// below and 50 µs above the true delay. The difference of the clocks' readings is 1 s longer
    /// than the true delay, because the clocks differ.
    fn passage(payload_bytes: u64, number: u64) -> Passage {
        let true_delay = 60e-6 + 1e-9 * payload_bytes as f64 + (number % 7) as f64 * 1e-6;
        let span = Span::from_seconds_f64;
        let bounds = Interval { lo: span((true_delay - 50e-6).max(0.0)), hi: span(true_delay + 50e-6) };
        let delay = OneWayDelay {
            raw: span(true_delay + 1.0),
            value: Some(span(true_delay)),
            bounds: Some(bounds),
            source: DelaySource::InBand,
            verdict: Verdict::Limited,
        };
        Passage { payload_bytes, metadata_bytes: 120, delay }
    }

    fn study() -> Study {
        let sizes = [100, 1_000, 10_000, 100_000, 1_000_000, 4_000_000];
        let sample = |(number, payload_bytes): (u64, u64)| Sample {
            number,
            at: number as f64,
            payload_bytes,
            warm_up: false,
            outcome: Outcome::Ok,
            reason: None,
            total: Some(1e-3),
            up: Some(passage(payload_bytes, number)),
            down: Some(passage(payload_bytes, number + 3)),
        };
        let samples = (0..100).flat_map(|_| sizes).zip(1..).map(|(size, number)| sample((number, size)));
        let setting = Setting { sizes_bytes: sizes.to_vec(), repeats: 100, ..Setting::default() };
        Study::new(setting, samples.collect(), &[])
    }

    #[test]
    fn calibration_figures_have_texts_and_colours() {
        let folder = tempfile::tempdir().expect("a folder");
        let files = draw_calibration(&study(), folder.path()).expect("writable");
        let names: Vec<_> = files.iter().filter_map(|path| path.file_name()?.to_str()).collect();
        assert_eq!(
            names,
            [
                "latency.png",
                "latency.svg",
                "latency.pdf",
                "latency-caption.txt",
                "throughput.png",
                "throughput.svg",
                "throughput.pdf",
                "throughput-caption.txt"
            ]
        );
        for (name, texts) in [
            ("latency.svg", ["One-way delay, ms", "Size on the wire", "1 kB", "upload:"]),
            ("throughput.svg", ["Throughput, MB/s", "Size on the wire", "1 MB", "download:"]),
        ] {
            let svg = std::fs::read_to_string(folder.path().join(name)).expect("written");
            for text in texts.iter().chain(&["#d55e00", "#ae5485"]) {
                assert!(svg.contains(text), "{name} lacks {text}");
            }
        }
        for name in ["latency-caption.txt", "throughput-caption.txt"] {
            let caption = std::fs::read_to_string(folder.path().join(name)).expect("written");
            assert!(caption.contains("clock bounds"), "{caption}");
        }
        for name in ["latency.png", "throughput.png"] {
            let picture = image::open(folder.path().join(name)).expect("a picture").to_rgb8();
            let dark = picture.pixels().filter(|pixel| pixel.0.iter().all(|channel| *channel < 0x40)).count();
            assert!(dark > 1_000, "{name} has no text: {dark} dark pixels");
        }
    }

    #[test]
    fn calibration_without_delays_removes_earlier_figures() {
        let folder = tempfile::tempdir().expect("a folder");
        draw_calibration(&study(), folder.path()).expect("writable");
        std::fs::write(folder.path().join("notes.txt"), "mine").expect("writable");
        let without_delays = Study::new(Setting::default(), Vec::new(), &[]);
        assert!(draw_calibration(&without_delays, folder.path()).expect("writable").is_empty());
        let entries = std::fs::read_dir(folder.path()).expect("a folder");
        let names: Vec<_> = entries.map(|entry| entry.expect("readable").file_name()).collect();
        assert_eq!(names, ["notes.txt"]);
    }
}
