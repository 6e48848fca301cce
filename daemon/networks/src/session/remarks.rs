//! Remarks of a transport about a connection.

use tokio::sync::watch;

/// Maximum number of stored remarks of one connection.
const MAX_REMARKS: usize = 64;

/// Remarks about one connection, oldest first. Remarks are never removed. After [`MAX_REMARKS`] remarks, a further
/// remark is only logged.
#[derive(Debug)]
pub(super) struct Remarks {
    texts: watch::Sender<Vec<String>>,
}

impl Remarks {
    /// Creates the list with the remarks that the transport made while the session was opened.
    pub(super) fn new(texts: Vec<String>) -> Self {
        Self { texts: watch::Sender::new(texts) }
    }

    /// Adds a remark.
    pub(super) fn add(&self, text: String) {
        self.texts.send_if_modified(|texts| {
            let is_added = texts.len() < MAX_REMARKS;
            if is_added {
                texts.push(text);
            } else {
                tracing::warn!("{text}");
            }
            is_added
        });
    }

    /// Returns a reader that sees the existing texts as changed.
    pub(super) fn subscribe(&self) -> watch::Receiver<Vec<String>> {
        let mut texts = self.texts.subscribe();
        // A reader that waits for a change must also get the earlier remarks.
        texts.mark_changed();
        texts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_remarks_stay_when_there_are_too_many() {
        let remarks = Remarks::new(vec!["0".to_owned()]);
        for n in 1..2 * MAX_REMARKS {
            remarks.add(n.to_string());
        }
        let mut reader = remarks.subscribe();
        assert!(reader.has_changed().expect("open"));
        let texts = reader.borrow_and_update();
        assert_eq!(texts.len(), MAX_REMARKS);
        assert!(texts.iter().enumerate().all(|(n, text)| *text == n.to_string()));
    }
}
