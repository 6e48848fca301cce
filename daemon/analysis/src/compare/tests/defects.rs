//! Comparisons of runs with labels or values that cannot be used.

use super::*;

#[test]
fn labels_outside_model_classes_are_not_scored() {
    let mut runs = paper();
    for run in &mut runs[..2] {
        run.rows.change(|row| row.values.push(("unknown-label".into(), 1.0)));
        run.record.facts.push(("Classes".to_owned(), "4: good, dented".to_owned()));
    }
    let comparison = Comparison::new(&runs);
    let names = [0, 1].map(|index: usize| format!("{}: 100 of 100 iterations", comparison.lines[index].name));
    let sentence = format!(
        "Not scored: {}, because the label is not a class of the model (classes: good, dented).",
        names.join("; ")
    );
    assert!(comparison.text().contains(&sentence), "{sentence} in {}", comparison.text());
    assert!(!comparison.text().contains("Top-1"), "nothing was scored");
    assert!(needs_column("unknown-label"), "a comparison reads only the columns that it needs");
}

#[test]
fn defects_of_results_are_noted() {
    let mut broken = run("broken\nline", [Some(1.0), Some(5.0), Some(3.0), Some(1.0)]);
    assert!(Comparison::new(std::slice::from_ref(&broken)).caveats.is_empty());
    let mut set_value = |iteration: u64, name: &str, new_value: Option<f64>| {
        broken.rows.change(|row| {
            if row.iteration == iteration {
                row.values.retain(|(other, _)| other != name);
                row.values.extend(new_value.map(|value| (name.to_owned().into(), value)));
            }
        });
    };
    set_value(21, "upload", None);
    set_value(22, "upload", Some(f64::INFINITY));
    set_value(23, "sensing", Some(f64::NEG_INFINITY));
    broken.record.format = 1;
    let unseen = 0;
    broken.record.counts = crate::record::Counts::from_rows(&broken.rows, unseen);
    broken.record.counts.ok += 4;
    let other = run("other", [Some(1.0), Some(5.0), Some(3.0), Some(1.0)]);
    let text = Comparison::new(&[broken, other]).text();
    for sentence in [
        "Incomplete results: results/broken line: data.csv has 106 rows, but run.json counts 110 iterations.",
        "sensing of broken line: 1 of 100 iterations; upload of broken line: 2 of 100 iterations",
    ] {
        assert!(text.contains(sentence), "{sentence}: {text}");
    }
}
