use std::fs;
use std::path::Path;

use peernet_sample::{LabelledObject, MaskLabel, MediaType, ObjectsLabel, Sample};
use peernet_sensors::sensor::images::{ImagesConfig, Order};
use peernet_sensors::{Sensor, SensorError, SensorKind};

use super::{clock, next, sources};

fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("can be made");
    for (name, content) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("is below the folder")).expect("can be made");
        fs::write(path, content).expect("can be written");
    }
    folder
}

/// Returns a configuration that repeats the pictures endlessly.
fn config(path: &Path, order: Order) -> ImagesConfig {
    ImagesConfig { path: path.to_owned(), order, seed: 1, repeat: true, labels: None }
}

/// Opens a sensor that yields each picture once, in the order of names.
fn open_once(path: &Path) -> Result<Box<dyn Sensor>, SensorError> {
    ImagesConfig { repeat: false, ..config(path, Order::Name) }.open(&clock())
}

/// Opens a sensor that repeats the pictures endlessly, in the order of names.
fn open_repeating(path: &Path) -> Result<Box<dyn Sensor>, SensorError> {
    config(path, Order::Name).open(&clock())
}

fn open_error(path: &Path) -> String {
    open_repeating(path).err().expect("is refused").to_string()
}

#[test]
fn files_are_sent_unchanged_in_order_of_names() {
    let folder =
        folder(&[("b.jpg", "bytes of b"), ("a.PNG", "bytes of a"), ("c.txt", "no picture"), (".d.jpg", "")]);
    let mut once = open_once(folder.path()).expect("opens");
    let a = next(once.as_mut()).expect("reads").expect("first");
    assert_eq!((a.source.as_str(), &a.parts[0].description.media), ("a.PNG", &MediaType::Png));
    assert_eq!((&a.parts[0].bytes[..], a.label), (&b"bytes of a"[..], None));
    let b = next(once.as_mut()).expect("reads").expect("second");
    assert_eq!((b.source.as_str(), &b.parts[0].description.media), ("b.jpg", &MediaType::Jpeg));
    assert!(next(once.as_mut()).expect("ends").is_none());
    assert!(next(once.as_mut()).expect("stays at its end").is_none());

    let mut repeating = open_repeating(folder.path()).expect("opens");
    assert_eq!(sources(repeating.as_mut(), 5), ["a.PNG", "b.jpg", "a.PNG", "b.jpg", "a.PNG"]);
    let facts = repeating.facts();
    assert!(facts[0].1.starts_with("2 images of "), "{facts:?}");
    // sha256sum a.PNG b.jpg | sha256sum
    let expected_hash = "826c0a54f7c2d8bb84fc726a774bca6b068d982bc07be25b818b44d7bb260970";
    assert_eq!(facts[1], ("Data set".to_owned(), format!("2 files, 20 bytes, SHA-256 {expected_hash}")));
    let single = open_repeating(&folder.path().join("b.jpg")).expect("opens");
    // sha256sum b.jpg | sha256sum
    let expected_hash = "ae243e0b7ccc10a32b9e0ae51687ae87648850a914e05656bd142517f528bfe9";
    assert_eq!(single.facts()[1].1, format!("1 file, 10 bytes, SHA-256 {expected_hash}"));
}

#[test]
fn too_large_picture_fails_only_its_sample() {
    let folder = folder(&[("a.jpg", ""), ("b.jpg", "bytes of b")]);
    let largest = 1 << 30;
    // The file is sparse and takes no space on the disk.
    fs::File::create(folder.path().join("a.jpg"))
        .and_then(|file| file.set_len(largest + 1))
        .expect("is made");
    let mut sensor = open_once(folder.path()).expect("opens");
    let error = next(sensor.as_mut()).expect_err("is too large").to_string();
    assert!(error.contains("a.jpg: it has more than 1073741824 bytes"), "{error}");
    let b = next(sensor.as_mut()).expect("reads").expect("second");
    assert_eq!(&b.parts[0].bytes[..], b"bytes of b");
}

#[test]
fn labels_come_from_file_or_folders() {
    let with_labels_file = folder(&[
        ("a.jpg", ""),
        ("sub/b.jpg", ""),
        ("labels.csv", "file,label\na.jpg, good\nsub/b.jpg,dented\n"),
    ]);
    let mut sensor = open_once(with_labels_file.path()).expect("opens");
    let labels = [(); 2].map(|()| next(sensor.as_mut()).expect("reads").expect("there").label);
    assert_eq!(labels, [Some("good".to_owned()), Some("dented".to_owned())]);

    let partly_labelled =
        folder(&[("a.jpg", ""), ("b.jpg", ""), ("labels.csv", "file,label\na.jpg,\nb.jpg,good\n")]);
    let mut sensor = open_once(partly_labelled.path()).expect("opens");
    let labels = [(); 2].map(|()| next(sensor.as_mut()).expect("reads").expect("there").label);
    assert_eq!(labels, [None, Some("good".to_owned())], "an empty label is no label");

    let with_folders = folder(&[("good/a.jpg", ""), ("dented/b.jpg", ""), ("c.jpg", "")]);
    let mut sensor = open_once(with_folders.path()).expect("opens");
    let found: Vec<_> = (0..3)
        .map(|_| next(sensor.as_mut()).expect("reads").expect("there"))
        .map(|sample| (sample.source, sample.label))
        .collect();
    let expected = [("c.jpg", None), ("dented/b.jpg", Some("dented")), ("good/a.jpg", Some("good"))];
    assert_eq!(found, expected.map(|(source, label)| (source.to_owned(), label.map(str::to_owned))));

    let fact = ("Labels".to_owned(), "2 of 3: dented, good".to_owned());
    assert!(sensor.facts().contains(&fact), "{:?}", sensor.facts());
    assert!(sensor.facts().iter().all(|(name, _)| name != "Labels file"), "{:?}", sensor.facts());

    let mut single = open_once(&with_labels_file.path().join("a.jpg")).expect("opens");
    assert_eq!(next(single.as_mut()).expect("reads").expect("there").label.as_deref(), Some("good"));
    let file = with_labels_file.path().join("labels.csv");
    let bytes = std::fs::read(&file).expect("is there");
    let hash = peernet_external::sha256(bytes.as_slice()).expect("is read");
    let fact = ("Labels file".to_owned(), format!("{} SHA-256 {hash}", file.display()));
    assert!(single.facts().contains(&fact), "{:?}", single.facts());
}

#[test]
fn label_has_boxes_and_size_of_picture() {
    let folder = folder(&[(
        "labels.csv",
        "file,label,left,top,right,bottom\na.png,cat,1,2,3.5,4\nb.png,,,,,\na.png,dog,0,0,9,9\n",
    )]);
    let mut picture = peernet_imaging::Picture::default();
    let pixels = peernet_sample::Description::pixels(peernet_sample::PixelFormat::Grey8, 20, 10);
    let part = Sample::from_part(pixels, vec![0; 200].into()).parts.swap_remove(0);
    peernet_imaging::read_part(&part, peernet_sample::PixelFormat::Grey8, &mut picture).expect("fits");
    let png = peernet_imaging::encode(&picture, peernet_imaging::Encoding::Png).expect("encodes");
    for name in ["a.png", "b.png"] {
        fs::write(folder.path().join(name), &png.bytes).expect("can be written");
    }
    let mut sensor = open_once(folder.path()).expect("opens");
    let labels = [(); 2].map(|()| {
        let label = next(sensor.as_mut()).expect("reads").expect("there").label.expect("is listed");
        ObjectsLabel::parse(&label).expect("has objects")
    });
    let object = |label: &str, edges| LabelledObject { label: label.to_owned(), edges };
    let objects = vec![object("cat", [1.0, 2.0, 3.5, 4.0]), object("dog", [0.0, 0.0, 9.0, 9.0])];
    assert_eq!(labels[0], ObjectsLabel { objects, width: 20, height: 10 });
    assert_eq!(labels[1], ObjectsLabel { objects: Vec::new(), width: 20, height: 10 });
    let fact = ("Labels".to_owned(), "2 of 2: cat, dog".to_owned());
    assert!(sensor.facts().contains(&fact), "{:?}", sensor.facts());
}

#[test]
fn masks_are_labels_and_not_samples() {
    let folder = folder(&[
        ("a.jpg", "bytes of a"),
        ("b.jpg", "bytes of b"),
        ("labels.csv", "file,mask\na.jpg,masks/a.png\nb.jpg,\n"),
    ]);
    fs::create_dir(folder.path().join("masks")).expect("made");
    let mask = folder.path().join("masks/a.png");
    let refused_mask = |bytes: &[u8]| {
        fs::write(&mask, bytes).expect("written");
        open_error(folder.path())
    };
    assert!(
        open_error(folder.path()).contains("masks/a.png of a.jpg is no file"),
        "{}",
        open_error(folder.path())
    );
    assert!(refused_mask(b"no picture").contains("masks/a.png: the png file cannot be read"));

    let pixels = peernet_sample::Description::pixels(peernet_sample::PixelFormat::Grey8, 2, 1);
    let part = Sample::from_part(pixels, vec![3, 255].into()).parts.swap_remove(0);
    let mut picture = peernet_imaging::Picture::default();
    peernet_imaging::read_part(&part, peernet_sample::PixelFormat::Grey8, &mut picture).expect("fits");
    let png = peernet_imaging::encode(&picture, peernet_imaging::Encoding::Png).expect("encodes");
    fs::write(&mask, &png.bytes).expect("written");
    let mut sensor = open_once(folder.path()).expect("opens");
    let first = next(sensor.as_mut()).expect("reads").expect("there");
    let label = MaskLabel::parse(first.label.as_deref().expect("is listed")).expect("names a mask");
    assert_eq!(Path::new(&label.mask), mask);
    assert_eq!(peernet_sensors::read_mask(&mask).expect("is a mask"), part);
    assert_eq!(
        next(sensor.as_mut()).expect("reads").expect("there").label,
        None,
        "a row without a mask gives no label"
    );
    assert!(next(sensor.as_mut()).expect("reads").is_none(), "the mask is no picture");
    let hash = peernet_external::sha256(&png.bytes[..]).expect("is read");
    let list = format!("{hash}  masks/a.png\n");
    let hash = peernet_external::sha256(list.as_bytes()).expect("is read");
    let fact = ("Masks".to_owned(), format!("1 file, {} bytes, SHA-256 {hash}", png.bytes.len()));
    assert!(sensor.facts().contains(&fact), "{:?}", sensor.facts());
    assert!(sensor.facts().contains(&("Labels".to_owned(), "1 of 2".to_owned())), "{:?}", sensor.facts());
}

#[test]
fn seed_determines_new_order_of_each_round() {
    let names: Vec<_> = (0..30).map(|index| format!("{index:02}.jpg")).collect();
    let files: Vec<_> = names.iter().map(|name| (name.as_str(), "")).collect();
    let folder = folder(&files);
    let rounds = |seed| {
        let mut sensor =
            ImagesConfig { seed, ..config(folder.path(), Order::Shuffled) }.open(&clock()).expect("opens");
        [(); 3].map(|()| sources(sensor.as_mut(), 30))
    };
    assert_eq!(rounds(7), rounds(7));
    assert_ne!(rounds(7), rounds(8));
    let [first, second, third] = rounds(7);
    assert_ne!(first, second);
    for mut round in [first, second, third] {
        round.sort();
        assert_eq!(round, names);
    }
}

#[test]
fn error_names_wrong_file_or_label() {
    let empty = folder(&[("readme.txt", "")]);
    assert!(open_error(empty.path()).contains("contains no picture"));
    assert!(open_error(&empty.path().join("missing")).contains("missing"));
    assert!(open_error(&empty.path().join("readme.txt")).contains("neither a folder nor"));
    for (labels, expected) in [
        ("file,label\nb.jpg,good\n", "b.jpg"),
        ("name,class\na.jpg,good\n", "file,label"),
        ("file,label\na.jpg,good\na.jpg,dented\n", "both good and dented"),
        ("", "contains no label"),
        ("file,label\n", "contains no label"),
        ("file,label\na.jpg,\n", "contains no label"),
        ("file,label,left,top,right,bottom\na.jpg,cat,1,2,3,\n", "the box of cat in a.jpg is incomplete"),
        ("file,label,left,top,right,bottom\na.jpg,cat,3,2,1,4\n", "left < right"),
    ] {
        let folder = folder(&[("a.jpg", ""), ("labels.csv", labels)]);
        let error = open_error(folder.path());
        assert!(error.contains(expected) && error.contains("labels.csv"), "{error}");
    }
}

#[test]
fn only_files_and_links_to_files_are_pictures() {
    let folder = folder(&[("a.jpg", "bytes of a")]);
    let _socket = std::os::unix::net::UnixListener::bind(folder.path().join("b.jpg")).expect("made");
    std::os::unix::fs::symlink("a.jpg", folder.path().join("c.jpg")).expect("made");
    std::os::unix::fs::symlink("b.jpg", folder.path().join("d.jpg")).expect("made");
    let mut sensor = open_repeating(folder.path()).expect("opens");
    assert_eq!(sources(sensor.as_mut(), 3), ["a.jpg", "c.jpg", "a.jpg"]);
    assert!(open_error(&folder.path().join("b.jpg")).contains("neither"));
}

#[test]
fn deleted_picture_fails_only_its_sample() {
    let folder = folder(&[("a.jpg", ""), ("b.jpg", ""), ("c.jpg", "")]);
    let mut sensor = open_once(folder.path()).expect("opens");
    fs::remove_file(folder.path().join("b.jpg")).expect("is there");
    assert_eq!(sources(sensor.as_mut(), 1), ["a.jpg"]);
    let error = next(sensor.as_mut()).expect_err("is gone").to_string();
    assert!(error.contains("b.jpg"), "{error}");
    assert_eq!(sources(sensor.as_mut(), 1), ["c.jpg"]);
}

#[test]
fn labels_file_may_be_in_another_folder() {
    let pictures = folder(&[("x/a.jpg", ""), ("b.jpg", "")]);
    let elsewhere = folder(&[
        ("of-all.csv", "file,label\nx/a.jpg,cat\nb.jpg,dog\nz.jpg,bird\n"),
        ("of-others.csv", "file,label\nz.jpg,bird\n"),
    ]);
    let open_with = |file: &str| {
        let (path, labels) = (pictures.path().to_owned(), Some(elsewhere.path().join(file)));
        ImagesConfig { path, order: Order::Name, seed: 1, repeat: true, labels }.open(&clock())
    };
    let mut sensor = open_with("of-all.csv").expect("more labels than pictures are fine");
    let labels: Vec<_> =
        (0..2).map(|_| next(sensor.as_mut()).expect("reads").expect("goes on").label).collect();
    assert_eq!(labels, [Some("dog".to_owned()), Some("cat".to_owned())]);
    for (file, part) in [("of-others.csv", "labels no picture"), ("not-there.csv", "not-there.csv")] {
        let error = open_with(file).err().expect("is refused").to_string();
        assert!(error.contains(part), "{error}");
    }
}
