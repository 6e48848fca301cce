//! Folders of models: which models are found in folders, and which of them a bank offers.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::sync_channel;

use peernet_clock::Span;
use peernet_inference::bank::ModelFolders;
use peernet_inference::{
    Bank, BankConfig, LoadError, LoadedModels, MODEL_HASH, OnnxRuntimeConfig, Pool, UnloadReason,
};

use super::{clock, demo, slug};

/// Makes a model folder with links to the files of the demo model.
fn link_demo_model(folder: &Path, name: &str) -> PathBuf {
    let model = folder.join(name);
    fs::create_dir_all(&model).expect("made");
    for file in ["model.onnx", "model.toml"] {
        symlink(demo().join(file), model.join(file)).expect("linked");
    }
    model
}

fn config(folder: &Path, keys: &str) -> BankConfig {
    toml::from_str(&format!("folders = [{folder:?}]\n{keys}")).expect("reads")
}

fn bank(folder: &Path, keys: &str) -> Bank {
    Bank::new(Vec::new(), OnnxRuntimeConfig::default(), clock()).with_folders(config(folder, keys))
}

#[test]
fn models_are_found_by_name_and_path() {
    let root = tempfile::tempdir().expect("a folder");
    let (first, second) = (root.path().join("first"), root.path().join("second"));
    let preferred = link_demo_model(&first, "twin");
    let shadowed = link_demo_model(&second, "twin");
    link_demo_model(&second, "efficientnet_v2_s");
    fs::create_dir(second.join("scripts")).expect("made");
    link_demo_model(&second, "-no-name");
    fs::create_dir(second.join("broken")).expect("made");
    fs::write(second.join("broken/model.toml"), "name = 7").expect("written");
    let folders = ModelFolders::new([first, root.path().join("nowhere"), second.clone(), second]);

    let listed: Vec<(String, bool, bool)> = folders
        .list()
        .into_iter()
        .map(|found| (found.name.to_string(), found.card.is_ok(), found.shadowed_by.is_some()))
        .collect();
    let expected = [
        ("twin", true, false),
        ("broken", false, false),
        ("efficientnet_v2_s", true, false),
        ("twin", true, true),
    ];
    assert_eq!(
        listed,
        expected.map(|(name, is_card_valid, is_shadowed)| (name.to_owned(), is_card_valid, is_shadowed))
    );
    assert!(folders.check().is_empty(), "a missing folder is no error");

    assert_eq!(folders.find("twin").expect("is there").folder, preferred);
    let path = format!("{}/", shadowed.display());
    assert_eq!(folders.find(&path).expect("is there").folder, shadowed);
    for missing in ["twins", "..", "", "no such name"] {
        let error = folders.find(missing).expect_err(missing);
        assert!(matches!(&error, LoadError::NotFound { .. }), "{error}");
        assert!(
            error.to_string().contains("efficientnet_v2_s") && error.to_string().contains("nowhere"),
            "{error}"
        );
    }
    let error = folders.find(&format!("{}/", root.path().display())).expect_err("no model");
    assert!(error.to_string().contains("neither model.onnx nor model.toml"), "{error}");
}

#[test]
fn bank_offers_complete_models_on_allowed_devices() {
    let root = tempfile::tempdir().expect("a folder");
    let bank = bank(root.path(), "");
    assert!(matches!(bank.default_model(), Err(LoadError::Unnamed { known }) if known.is_empty()));
    link_demo_model(root.path(), "plates");
    fs::create_dir(root.path().join("broken")).expect("made");
    fs::write(root.path().join("broken/model.onnx"), "").expect("written");
    assert_eq!(bank.offered_names(), [slug("plates")]);
    assert_eq!(bank.default_model().expect("the only one"), slug("plates"));

    let pool = bank.load(&slug("plates"), Some("cpu")).expect("loads");
    assert_eq!((pool.name().as_str(), pool.device().as_str()), ("plates", "cpu"));
    let hash = pool.facts().into_iter().find(|(name, _)| name == MODEL_HASH).expect("is recorded").1;
    let card = fs::read_to_string(demo().join("model.toml")).expect("is committed");
    assert!(card.contains(&hash), "the card does not state the hash {hash} of its model");

    let error = bank.load(&slug("plates"), Some("cuda:0")).expect_err("not offered").to_string();
    assert!(error.contains("cuda:0") && error.contains("only on cpu"), "{error}");
    assert!(matches!(bank.load(&slug("broken"), None), Err(LoadError::File { .. })));
    let error = bank.load(&slug("plate"), None).expect_err("unknown").to_string();
    assert!(error.contains("plates") && !error.contains(&root.path().display().to_string()), "{error}");
    link_demo_model(root.path(), "second");
    let error = bank.default_model().expect_err("two").to_string();
    assert!(error.contains("plates, second"), "{error}");
    bank.shutdown();
}

#[test]
fn configured_model_takes_precedence_over_folder_model() {
    let root = tempfile::tempdir().expect("a folder");
    link_demo_model(root.path(), "echo");
    link_demo_model(root.path(), "plates");
    let echo = |name: &str| toml::from_str(&format!("kind = 'echo'\nname = '{name}'")).expect("reads");
    let bank = Bank::new(vec![echo("echo")], OnnxRuntimeConfig::default(), clock())
        .with_built_in(echo("calibration"))
        .with_folders(config(root.path(), ""));
    assert_eq!(bank.offered_names(), [slug("echo"), slug("plates")]);
    assert_eq!(bank.default_model().expect("the configured one"), slug("echo"));
    assert!(
        !bank.load(&slug("echo"), None).expect("is there").runs_on_threads(),
        "the configured model echoes"
    );
    assert!(bank.load(&slug("calibration"), None).is_ok());
}

#[test]
fn only_idle_models_are_unloaded_at_limit() {
    let root = tempfile::tempdir().expect("a folder");
    for name in ["a", "b", "c"] {
        link_demo_model(root.path(), name);
    }
    let (unload_sender, unloads) = sync_channel(2);
    let bank = bank(root.path(), "most_loaded = 2")
        .on_unload(move |model| unload_sender.send(model.clone()).expect("the channel has room"));
    let load = |name: &str| bank.load(&slug(name), None);
    assert_eq!(bank.loaded_models(), LoadedModels::default());
    let a = load("a").expect("has room");
    let b = load("b").expect("has room");
    let error = load("c").expect_err("both are in use").to_string();
    assert!(error.contains("a on cpu, b on cpu") && error.contains("most_loaded"), "{error}");
    assert!(Arc::ptr_eq(&a, &load("a").expect("is loaded")), "model a is already loaded");

    // Now model b is the one that was requested longest ago.
    let weak_b = Arc::downgrade(&b);
    drop((a, b));
    let c = load("c").expect("b is unloaded");
    assert!(weak_b.upgrade().is_none(), "b was unloaded");
    let model = unloads.try_recv().expect("is reported");
    assert_eq!((&model.name, &*model.device), (&slug("b"), "cpu"));
    assert_eq!(model.reason, UnloadReason::MakesRoomFor(slug("c")));
    assert!(model.loaded_for > Span::ZERO && model.memory_released.is_some(), "{model:?}");
    let memory = |pool: &Pool| pool.memory_growth().expect("is known");
    assert_eq!(
        bank.loaded_models(),
        LoadedModels { count: 2, memory_bytes: memory(&c) + memory(&load("a").expect("is loaded")) }
    );
    let reloaded_b = load("b").expect("a is unloaded, because c is in use");
    assert!(load("a").is_err());
    drop((c, reloaded_b));
    assert_eq!(unloads.try_recv().map(|model| model.name), Ok(slug("a")));
    bank.shutdown();
    assert_eq!(bank.loaded_models(), LoadedModels::default());
    let mut unloaded_at_shutdown: Vec<_> =
        unloads.try_iter().map(|model| (model.name.to_string(), model.reason)).collect();
    unloaded_at_shutdown.sort_by(|(a, _), (b, _)| a.cmp(b));
    let expected = |name: &str| (name.to_owned(), UnloadReason::Shutdown);
    assert_eq!(unloaded_at_shutdown, [expected("b"), expected("c")]);
}

#[test]
fn replaced_model_is_reloaded_when_unused() {
    let root = tempfile::tempdir().expect("a folder");
    let folder = link_demo_model(root.path(), "plates");
    let (unload_sender, unloads) = sync_channel(1);
    let bank = bank(root.path(), "")
        .on_unload(move |model| unload_sender.send(model.reason.clone()).expect("the channel has room"));
    let old = bank.load(&slug("plates"), None).expect("loads");
    let card = fs::read_to_string(demo().join("model.toml")).expect("is committed");
    fs::remove_file(folder.join("model.toml")).expect("removed");
    fs::write(folder.join("model.toml"), card.replace("version = \"1\"", "version = \"22\""))
        .expect("written");
    let error = bank.load(&slug("plates"), None).expect_err("in use").to_string();
    assert!(error.contains("changed while it is in use"), "{error}");
    drop(old);
    let new = bank.load(&slug("plates"), None).expect("loads");
    assert!(new.facts().iter().any(|(_, value)| value == "quality-control 22"), "{:?}", new.facts());
    assert_eq!(unloads.try_recv(), Ok(UnloadReason::FilesChanged));
}

#[test]
fn failed_load_leaves_no_cache_entry() {
    let root = tempfile::tempdir().expect("a folder");
    link_demo_model(root.path(), "good");
    let bad = link_demo_model(root.path(), "bad");
    fs::remove_file(bad.join("model.onnx")).expect("removed");
    fs::write(bad.join("model.onnx"), b"\x3a\x00").expect("written"); // an empty graph
    let bank = bank(root.path(), "most_loaded = 1");
    for _ in 0..2 {
        assert!(matches!(bank.load(&slug("bad"), None), Err(LoadError::Session { .. })));
    }
    let good = bank.load(&slug("good"), None).expect("the failed model takes no place in the cache");
    assert!(matches!(bank.load(&slug("bad"), None), Err(LoadError::BankFull { .. })));
    drop(good);
}

#[test]
fn each_error_of_bank_table_names_its_key() {
    let root = tempfile::tempdir().expect("a folder");
    fs::write(root.path().join("file"), "").expect("written");
    let keys = "devices = ['cpu', 'gpu']\nmost_loaded = 65\nqueue = 70000";
    let errors = bank(&root.path().join("file"), keys).check_folders();
    let keys_of_errors: Vec<&str> = errors.iter().map(|(key, _)| *key).collect();
    assert_eq!(keys_of_errors, ["folders", "most_loaded", "queue", "devices"], "{errors:?}");
}

#[test]
fn bank_without_devices_offers_no_model() {
    let root = tempfile::tempdir().expect("a folder");
    let without_devices = config(root.path(), "devices = []");
    link_demo_model(root.path(), "plates");
    let bank = Bank::new(Vec::new(), OnnxRuntimeConfig::default(), clock()).with_folders(without_devices);
    assert!(bank.offered_names().is_empty());
    for device in [None, Some("cpu")] {
        let error = bank.load(&slug("plates"), device).expect_err("no device is offered").to_string();
        assert!(error.contains("offered on no device, because devices is empty in [bank]"), "{error}");
    }
}

#[test]
fn invalid_cards_do_not_block_listing() {
    let parent = tempfile::tempdir().expect("a folder");
    let folder = |name: &str| {
        let folder = parent.path().join(name);
        std::fs::create_dir(&folder).expect("writable");
        folder
    };
    std::os::unix::fs::symlink("/dev/zero", folder("endless").join("model.toml")).expect("writable");
    std::fs::write(folder("long").join("model.toml"), vec![b'#'; 2 << 20]).expect("writable");
    std::fs::write(folder("secret").join("model.toml"), "root:x:0:0:root").expect("writable");

    let found = ModelFolders::new([parent.path().to_owned()]).list();
    let reasons: Vec<_> =
        found.iter().map(|found| found.card.as_ref().expect_err("no card").to_string()).collect();
    assert_eq!(found.len(), 3, "{reasons:?}");
    for (reason, part) in reasons.iter().zip(["regular file", "the limit is", "root:x"]) {
        assert!(reason.contains(part), "{reason}");
    }
    for found in &found {
        let text_for_peer = found.card.as_ref().expect_err("no card").to_peer(found.name.as_str(), "cloud");
        assert!(text_for_peer.contains(found.name.as_str()), "{text_for_peer}");
        assert!(
            !text_for_peer.contains("root:x") && !text_for_peer.contains(&*parent.path().to_string_lossy()),
            "{text_for_peer}"
        );
    }
}
