//! Outputs of which no answer can be made.

use super::graphs::{answer, grey_picture, model};
use super::slug;

#[test]
fn error_names_output_with_unusable_numbers() {
    for (name, reason) in [
        ("classes-nan", "its output \"y\" contains NaN"),
        ("classes-infinite", "its output \"y\" contains inf"),
        ("embedding-infinite", "its output \"y\" contains inf"),
        ("embedding-zero", "its output \"y\" consists of zeros, so it cannot be normalised"),
        ("nms-infinite-score", "its output \"scores\" contains inf"),
    ] {
        let error = answer(name, vec![grey_picture()]).expect_err(name);
        assert_eq!(error.to_string(), format!("model {name} failed: {reason}"));
    }
}

#[test]
fn error_names_labels_only_for_wrong_class_count() {
    let card_form = "its card says float32, float16 or float64 of shape [1, 3] or [3]";
    for (name, form, remedy) in [
        ("classes-bool", "bool of shape [1, 3]", ""),
        ("classes-rank-3", "float32 of shape [1, 3, 1]", ""),
        ("classes-two-rows", "float32 of shape [2, 3]", ""),
        ("classes-four", "float32 of shape [1, 4]", ", because `labels` has 3; write a label for each class"),
    ] {
        let error = model(name).load(&slug(name), None).expect_err(name).to_string();
        assert!(error.ends_with(&format!("its output \"y\" is {form}, {card_form}{remedy}")), "{error}");
    }
}
