//! Names of configurations in sentences.

use super::*;

#[test]
fn sentences_name_lines_as_figures_do() {
    let configured = |resize: &str, edges: &str, millis: f64| {
        let run = run(&format!("{resize}-{edges}"), [Some(millis), None, Some(3.0), None]);
        with_position(&[("resize", resize), ("edges", edges)], 1, run)
    };
    let runs = [configured("yes", "1", 1.0), configured("no", "4", 2.0), configured("no", "1", 9.0)];
    let comparison = Comparison::new(&runs);
    let names: Vec<&str> = comparison.lines.iter().map(|line| line.name.as_str()).collect();
    assert_eq!(names, ["resize, edges 1", "no resize, edges 4", "no resize, edges 1"]);
    let text = comparison.text();
    assert!(text.contains("Smallest mean total (measured): resize, edges 1;"), "{text}");
}
