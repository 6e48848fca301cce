//! Test of a program that prints much, with control characters: the log stays short and readable.

use peernet_tests::LoopbackDeployment;

/// Number of lines that the program prints with its first answer; the script has the same number.
const PRINTED_LINES: u64 = 100_000;

const MODEL: &str = r#"#!/bin/sh
printf '\033[31mred\033[0m\a\377 \rprogress 10 %%\rprogress 100 %%\n' >&2
while read -r word bytes media shape source; do
    head -c "$bytes" > /dev/null
    [ -e printed ] || seq -f 'line %.0f of a loop that prints too much' 100000 >&2
    touch printed
    echo "answer 2"; printf ok
done
"#;

const EDGE: &str = r#"
[[model]]
name = "talkative"
kind = "exec"
command = "sh talkative.sh"
folder = "{folder}"

[[pipeline]]
name = "line"
sensor = { kind = "text", length = 20 }
placement = { kind = "local", model = "talkative" }
timeout_ms = 60000
warm_up = { iterations = 0 }
limit = { total = 20 }
"#;

#[test]
fn long_output_is_limited_and_escaped_in_log() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    deployment.write("talkative.sh", MODEL);
    let edge = deployment.start_agent("edge", EDGE);
    let run = api.wait_for_finished_run();
    let counts = api.json(&format!("/api/v1/runs/{run}"))["counts"].clone();
    assert_eq!(counts["ok"].as_u64(), Some(20), "{counts}");

    let end = edge.stop();
    assert_eq!(end.code(), 0);
    let is_printed_line =
        |line: &&str| line.contains("line ") && line.contains("of a loop that prints too much");
    let logged_lines = end.log.lines().filter(is_printed_line).count() as u64;
    assert!(
        (1..1_000).contains(&logged_lines) && end.log.len() < 200_000,
        "{logged_lines} of {PRINTED_LINES} lines"
    );
    let omitted = end.log.lines().filter_map(|line| {
        let (count, _) = line.split_once("left out ")?.1.split_once(" lines (")?;
        count.parse::<u64>().ok()
    });
    assert_eq!(logged_lines + omitted.sum::<u64>(), PRINTED_LINES, "{}", end.log);
    assert!(!end.log.contains(|char: char| char.is_control() && char != '\n'), "{:?}", end.log);
    for part in [r"\u{1b}[31mred\u{1b}[0m\u{7}\xff", "progress 10 %", "progress 100 %", "PEERNET_LOG="] {
        assert!(end.log.contains(part), "{part} is missing in {}", end.log);
    }
}
