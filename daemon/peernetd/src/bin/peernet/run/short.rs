//! Messages that hold a value of the user's, which may have thousands of characters.

use anyhow::anyhow;
use peernetd::exit::Failure;

/// Characters of the longest line that is told whole.
const LONGEST: usize = 600;
/// Characters that are kept of a longer one: what it is about stands in front, what was expected at its end.
const FRONT: usize = 300;
const BACK: usize = 200;

/// The failure with the middle of overlong lines left out.
pub(super) fn short(failure: Failure) -> Failure {
    let text = failure.to_string();
    if text.lines().all(|line| line.len() <= LONGEST) {
        return failure;
    }
    let lines: Vec<String> = text.lines().map(shortened).collect();
    Failure::new(failure.exit, anyhow!("{}", lines.join("\n")))
}

fn shortened(line: &str) -> String {
    let all = line.chars().count();
    if all <= LONGEST {
        return line.to_owned();
    }
    let front: String = line.chars().take(FRONT).collect();
    let back: String = line.chars().skip(all - BACK).collect();
    format!("{front} […{} characters…] {back}", all - FRONT - BACK)
}

#[cfg(test)]
mod tests {
    use peernetd::exit::Exit;

    use super::*;

    #[test]
    fn the_middle_of_an_overlong_line_is_left_out() {
        let told = |text: String| short(Failure::new(Exit::Usage, anyhow!("{text}"))).to_string();
        assert_eq!(told("one\ntwo".to_owned()), "one\ntwo");
        let long = told(format!("e.toml: \"{}\", expected u64\nthe second line", "ü".repeat(5000)));
        assert!(
            long.starts_with("e.toml: \"üü") && long.ends_with(", expected u64\nthe second line"),
            "{long}"
        );
        assert!(long.chars().count() < LONGEST && long.contains(" characters…]"), "{long}");
    }
}
