//! Tests that an exported model answers as torchvision does.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_inference::bank::ModelFolders;
use peernet_inference::{Bank, Job, OnnxRuntimeConfig, Pool};
use peernet_logger::{HostId, Recorder};
use peernet_sample::{Description, MediaType, PixelFormat, Sample};
use serde_json::Value;

use super::{NAME, ReferenceAnswer, exported_model};

/// Largest difference from torchvision's numbers, as a share of the largest number.
///
/// The model agrees to 1e-5 in both libraries; the difference comes from its input. Scaling with another order of
/// rounding (columns or rows first, each rounded to whole bytes) makes one byte in eight differ by one from Pillow's,
/// and libjpeg decodes two bytes in a hundred differently. A model with random weights amplifies that to 0.005 to
/// 0.009, because it is less smooth than a trained one. Another filter, the smallest possible mistake in a card,
/// leads to 0.1.
const TOLERANCE: f64 = 0.01;

#[test]
fn exported_model_answers_like_torchvision() {
    let pool = load_model(&[]);
    for reference in &exported_model().answers {
        for (form, sample) in [("JPEG", jpeg(reference)), ("pixels", pixels(reference))] {
            let answer = logits(&pool, sample);
            let difference = difference(&reference.logits, &answer);
            assert!(difference < TOLERANCE, "{} as {form}: {difference}", reference.file.display());
            assert_eq!(
                top_five_classes(&answer),
                top_five_classes(&reference.logits),
                "{} as {form}",
                reference.file.display()
            );
        }
    }
}

/// With a wrong card, the test above would fail: a model with random weights still distinguishes inputs.
#[test]
fn card_mistakes_exceed_the_answer_tolerance() {
    let [reference, other_reference] = &*exported_model().answers else { panic!("two pictures") };
    assert!(
        difference(&reference.logits, &other_reference.logits) > 10.0 * TOLERANCE,
        "another picture has almost the same answer"
    );
    for change in [
        ("preprocessing.resize.filter", "bicubic"),
        ("preprocessing.resize.filter", "nearest"),
        ("preprocessing.resize.antialias", "false"),
        ("input.colour", "bgr"),
    ] {
        let difference_with_mistake =
            difference(&reference.logits, &logits(&load_model(&[change]), jpeg(reference)));
        assert!(difference_with_mistake > 5.0 * TOLERANCE, "{change:?}: {difference_with_mistake}");
    }
}

#[test]
fn card_matches_exported_weights() {
    let exported = ModelFolders::new([exported_model().models.clone()]).find(NAME).expect("was exported");
    let hash = exported.hash().expect("is read");
    let card = exported.card.expect("is right");
    assert_eq!((card.labels.len(), card.labels[0].as_str()), (1000, "tench"));
    assert_eq!((card.version.as_str(), card.input.as_str()), ("random-3", "1 × 3 × 384 × 384 float32 nchw"));
    assert!(
        card.preprocessing.iter().any(|step| step == "resize shorter side to 384, bilinear, antialiased")
    );
    assert!(card.provenance.contains(&("sha256".to_owned(), hash)));
}

/// Returns the five best classes, best first.
fn top_five_classes(logits: &[f64]) -> Vec<usize> {
    let mut classes: Vec<usize> = (0..logits.len()).collect();
    classes.sort_by(|a, b| logits[*b].total_cmp(&logits[*a]));
    classes.truncate(5);
    classes
}

/// Loads the exported model with a card that lists all numbers of the output unchanged. `changes` are pairs of a key of
/// the card and its new value.
fn load_model(changes: &[(&str, &str)]) -> Arc<Pool> {
    let exported = ModelFolders::new([exported_model().models.clone()]).find(NAME).expect("was exported");
    let models = tempfile::tempdir().expect("a folder");
    let folder = models.path().join(NAME);
    std::fs::create_dir(&folder).expect("made");
    let card = std::fs::read_to_string(exported.folder.join("model.toml")).expect("is there");
    let mut card: toml::Table = card.parse().expect("is TOML");
    let output = card["output"].as_table_mut().expect("is a table");
    output.insert("activation".to_owned(), "none".into());
    output.insert("top_k".to_owned(), 1000.into());
    // Two pairs of ImageNet's classes have the same label, so the classes are numbered.
    let labels: Vec<toml::Value> = (0..1000).map(|number| number.to_string().into()).collect();
    output.insert("labels".to_owned(), labels.into());
    for (path, value) in changes {
        let mut keys: Vec<&str> = path.split('.').collect();
        let key = keys.pop().expect("a key");
        let table = keys.iter().fold(&mut card, |table, key| table[*key].as_table_mut().expect("is a table"));
        let value = value.parse::<bool>().map_or_else(|_| (*value).into(), toml::Value::from);
        table.insert(key.to_owned(), value);
    }
    std::fs::write(folder.join("model.toml"), card.to_string()).expect("written");
    std::os::unix::fs::symlink(exported.folder.join("model.onnx"), folder.join("model.onnx"))
        .expect("linked");
    let model = ModelFolders::new([models.path().to_owned()]).find(NAME).expect("is complete");
    let bank = Bank::new(vec![model.configuration("cpu")], OnnxRuntimeConfig::default(), clock());
    bank.load(&model.name, None).unwrap_or_else(|error| panic!("{error}"))
}

/// Returns the numbers of the output, by class.
fn logits(pool: &Pool, sample: Sample) -> Vec<f64> {
    let (sender, receiver) = sync_channel(1);
    let reply = Box::new(move |done| sender.send(done).expect("is awaited"));
    let recorder = Recorder::new(clock(), HostId::random());
    let received = recorder.clock().mono();
    pool.submit(Job::for_whole_answer(sample, recorder, received, reply)).expect("the queue has room");
    let answer = receiver.recv().expect("is answered").result.unwrap_or_else(|error| panic!("{error}"));
    let answer: Value = serde_json::from_slice(&answer.parts[0].bytes).expect("is JSON");
    let mut numbers = vec![f64::NAN; 1000];
    for class_score in answer["top"].as_array().expect("is a list") {
        let class: usize =
            class_score["label"].as_str().and_then(|label| label.parse().ok()).expect("is a number");
        numbers[class] = class_score["score"].as_f64().expect("is a number");
    }
    assert!(numbers.iter().all(|number| number.is_finite()), "every class has its number");
    numbers
}

fn jpeg(reference: &ReferenceAnswer) -> Sample {
    let bytes = std::fs::read(&reference.file).expect("is committed");
    Sample::from_part(Description::unshaped(MediaType::Jpeg), bytes.into())
}

fn pixels(reference: &ReferenceAnswer) -> Sample {
    let bytes = std::fs::read(&reference.pixels).expect("the script wrote them");
    Sample::from_part(Description::pixels(PixelFormat::Rgb8, reference.width, reference.height), bytes.into())
}

/// Returns the largest difference of two answers, as a share of the largest number of the first one.
fn difference(a: &[f64], b: &[f64]) -> f64 {
    let largest = |values: &mut dyn Iterator<Item = f64>| values.map(f64::abs).fold(0.0, f64::max);
    largest(&mut a.iter().zip(b).map(|(a, b)| a - b)) / largest(&mut a.iter().copied())
}

fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("test", ClockIdentity::SYSTEM)))
}
