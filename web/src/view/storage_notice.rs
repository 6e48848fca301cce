//! The notice that every page shows while events are not stored.

use peernet_aggregator::Readiness;

/// Returns the reason as a sentence; `None` while events are stored.
pub(crate) fn notice(readiness: &Readiness) -> Option<String> {
    let Readiness::NotStoring(reason) = readiness else { return None };
    let mut characters = reason.chars();
    let first: String = characters.next()?.to_uppercase().collect();
    Some(format!("{first}{}.", characters.as_str().trim_end_matches('.')))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reason_is_formatted_as_a_sentence() {
        let not_storing =
            Readiness::NotStoring("cannot store events: the disk is full; agents keep them".into());
        assert_eq!(
            notice(&not_storing).as_deref(),
            Some("Cannot store events: the disk is full; agents keep them.")
        );
        assert_eq!(notice(&Readiness::Ready), None);
    }
}
