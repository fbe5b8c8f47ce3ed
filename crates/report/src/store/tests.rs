use super::*;

/// A folder to work in.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::create_dir_all(self.at(name).parent().unwrap()).unwrap();
        fs::write(self.at(name), text).unwrap();
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.at(name)).unwrap()
    }

    fn open_as(&self, fingerprint: &str, resume: bool, force: bool) -> Result<Store, StoreError> {
        Store::open(&Request { out: &self.at("out"), kind: "run", fingerprint, resume, force })
    }

    fn open(&self) -> Result<Store, StoreError> {
        self.open_as("a", false, false)
    }

    /// Complete results, with a file of this text.
    fn results(&self, text: &str) {
        let store = self.open_as("a", false, true).unwrap();
        store.folder().write("summary.json", text.as_bytes()).unwrap();
        store.folder().write("figures/rmse.svg", b"<svg/>").unwrap();
        fs::write(store.folder().claim("recording.rrd").unwrap(), "recorded").unwrap();
        store.finish().unwrap();
    }

    /// Every file and folder below, with the text of files.
    fn everything(&self) -> Vec<(PathBuf, Option<Vec<u8>>)> {
        fn visit(folder: &Path, found: &mut Vec<(PathBuf, Option<Vec<u8>>)>) {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                found.push((path.clone(), fs::read(&path).ok()));
                if path.is_dir() {
                    visit(&path, found);
                }
            }
        }
        let mut found = Vec::new();
        visit(self.0.path(), &mut found);
        found.sort();
        found
    }
}

#[test]
fn finished_work_leaves_the_results_with_a_manifest_and_nothing_beside_them() {
    let place = Place::new();
    place.results("{}");
    assert_eq!(fs::read_dir(place.0.path()).unwrap().count(), 1);
    let manifest = Manifest::read(&place.at("out/manifest.json")).unwrap().unwrap();
    let names: Vec<&str> = manifest.files.keys().map(String::as_str).collect();
    assert_eq!(names, ["figures/rmse.svg", "recording.rrd", "summary.json"]);
    assert_eq!(manifest.files["recording.rrd"], blake3::hash(b"recorded").to_hex().as_str());
}

#[test]
fn what_locsim_did_not_write_is_refused_and_left_whatever_is_asked_for() {
    for (name, link) in [
        ("out/thesis.tex", false),
        ("out/summary.json", false),
        ("out/results.json", false),
        ("out/gap.json", false),
        ("out/manifest.json", false),
        ("out/figures/notes.txt", false),
        ("out/.git/config", false),
        ("out/.hidden", false),
        ("out.partial/fingerprint", false),
        ("out.partial/manifest.json", false),
        ("out.partial/parts/000001.part", false),
        ("out.old/thesis.tex", false),
        ("out.old", false),
        ("out.partial", false),
        ("out", false),
        ("out/link", true),
    ] {
        for with_results in [false, true] {
            if with_results && !name.starts_with("out/") {
                continue;
            }
            let place = Place::new();
            if with_results {
                place.results("{}");
            }
            if link {
                fs::create_dir_all(place.at("out")).unwrap();
                place.write("elsewhere", "precious");
                #[cfg(unix)]
                std::os::unix::fs::symlink(place.at("elsewhere"), place.at(name)).unwrap();
            } else {
                place.write(name, "precious");
            }
            let before = place.everything();
            for (resume, force) in [(false, false), (true, false), (false, true)] {
                let refused = place.open_as("a", resume, force).unwrap_err();
                let named = matches!(
                    &refused,
                    StoreError::Foreign { .. }
                        | StoreError::NotEmpty { .. }
                        | StoreError::NoFolder { .. }
                        | StoreError::File { .. }
                );
                assert!(named, "{name}: {refused}");
                assert_eq!(place.everything(), before, "{name}, resume {resume}, force {force}");
            }
        }
    }
}

#[test]
fn a_file_that_was_changed_since_stays_and_one_that_is_gone_is_no_matter() {
    let place = Place::new();
    place.results("{}");
    place.write("out/figures/rmse.svg", "<svg>drawn by hand</svg>");
    let refused = place.open_as("a", false, true).unwrap_err();
    assert!(
        matches!(&refused, StoreError::Foreign { found, .. } if found.ends_with("rmse.svg")),
        "{refused}"
    );
    fs::remove_file(place.at("out/figures/rmse.svg")).unwrap();
    place.results("new");
    assert_eq!(place.read("out/summary.json"), "new");
}

#[test]
fn earlier_results_are_replaced_only_when_asked_for_and_when_new_ones_are_complete() {
    let place = Place::new();
    place.results("old");
    let refused = place.open().unwrap_err();
    assert!(matches!(refused, StoreError::NotEmpty { .. }), "{refused}");
    let store = place.open_as("b", false, true).unwrap();
    store.folder().write("summary.json", b"new").unwrap();
    assert_eq!(place.read("out/summary.json"), "old");
    store.finish().unwrap();
    assert_eq!(place.read("out/summary.json"), "new");
    assert_eq!(fs::read_dir(place.0.path()).unwrap().count(), 1);
}

#[test]
fn what_came_into_the_folder_meanwhile_stays_and_the_work_can_be_resumed() {
    let place = Place::new();
    place.results("old");
    let store = place.open_as("b", false, true).unwrap();
    store.parts().save(0, &1).unwrap();
    place.write("out/notes.txt", "precious");
    assert!(matches!(store.finish(), Err(StoreError::Foreign { found, .. }) if found.ends_with("notes.txt")));
    assert_eq!(
        (place.read("out/notes.txt"), place.read("out/summary.json")),
        ("precious".into(), "old".into())
    );
    fs::remove_file(place.at("out/notes.txt")).unwrap();
    let store = place.open_as("b", true, false).unwrap();
    assert_eq!(store.parts().load(0), Part::Whole(1));
    store.finish().unwrap();
    assert!(!place.at("out.partial").exists());
}

#[test]
fn parts_of_interrupted_work_are_taken_over_by_the_same_work_and_lost_to_nobody_unasked() {
    let place = Place::new();
    place.open().unwrap().parts().save(3, &"three").unwrap();
    assert_eq!(kept(&place.at("out")).unwrap(), 1);

    let refused = place.open().unwrap_err();
    assert!(matches!(refused, StoreError::Kept { parts: 1, .. }), "{refused}");
    let refused = place.open_as("b", true, false).unwrap_err();
    assert!(matches!(refused, StoreError::Other { parts: 1, .. }), "{refused}");
    let resumed = place.open_as("a", true, false).unwrap();
    assert_eq!(resumed.parts().load(3), Part::Whole("three".to_owned()));
    assert_eq!(resumed.parts().load::<String>(4), Part::Missing);
    drop(resumed);
    let anew = place.open_as("b", false, true).unwrap();
    assert_eq!(anew.parts().kept().unwrap(), 0);
}

#[test]
fn a_part_that_was_altered_or_is_anothers_is_known_by_its_hash() {
    let place = Place::new();
    let store = place.open().unwrap();
    store.parts().save(0, &"zero").unwrap();
    let file = place.at("out.partial/parts/000000.part");
    let whole = fs::read(&file).unwrap();
    for bit in 0..8 * whole.len() {
        let mut flipped = whole.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        fs::write(&file, flipped).unwrap();
        assert_eq!(store.parts().load::<String>(0), Part::Damaged, "bit {bit}");
    }
    fs::write(&file, &whole[..whole.len() - 1]).unwrap();
    assert_eq!(store.parts().load::<String>(0), Part::Damaged);
    fs::write(place.at("out.partial/parts/000001.part"), &whole).unwrap();
    assert_eq!(store.parts().load::<String>(1), Part::Damaged, "a part in the place of another");
    fs::write(&file, &whole).unwrap();
    assert_eq!(store.parts().load(0), Part::Whole("zero".to_owned()));
}

#[test]
fn one_process_works_on_results_and_the_other_is_told_who() {
    let place = Place::new();
    let store = place.open().unwrap();
    store.parts().save(0, &0).unwrap();
    for (resume, force) in [(false, true), (true, false)] {
        let refused = place.open_as("a", resume, force).unwrap_err();
        let who = format!("process {}", std::process::id());
        assert!(matches!(&refused, StoreError::Held { holder, .. } if holder.starts_with(&who)), "{refused}");
    }
    assert_eq!(store.parts().load(0), Part::Whole(0));
    drop(store);
    place.open_as("a", true, false).unwrap();
}

#[test]
fn work_under_way_is_not_judged_by_what_it_has_just_written() {
    let place = Place::new();
    let store = place.open().unwrap();
    place.write("out.partial/results/half", "");
    for (resume, force) in [(false, false), (true, false), (false, true)] {
        let refused = place.open_as("a", resume, force).unwrap_err();
        assert!(matches!(refused, StoreError::Held { .. }), "{refused}");
    }
    drop(store);
    let refused = place.open().unwrap_err();
    assert!(matches!(&refused, StoreError::Foreign { found, .. } if found.ends_with("half")), "{refused}");
}

/// The manifest is the first file of a folder; a kill may leave no more than what was to become it.
#[test]
fn a_kill_before_the_first_manifest_leaves_nothing_in_the_way() {
    let place = Place::new();
    drop(place.open().unwrap());
    fs::remove_file(place.at("out.partial/results/manifest.json")).unwrap();
    place.write("out.partial/results/.locsim-0ojqKP.tmp", "{");
    place.open_as("a", true, false).unwrap().finish().unwrap();
    assert!(place.at("out/manifest.json").is_file() && !place.at("out.partial").exists());
    fs::remove_file(place.at("out/manifest.json")).unwrap();
    place.write("out/.locsim-0ojqKP.tmp", "{");
    place.open().unwrap().finish().unwrap();
    assert!(place.at("out/manifest.json").is_file() && !place.at("out/.locsim-0ojqKP.tmp").exists());
}

#[test]
fn a_kill_between_any_two_steps_of_replacing_leaves_old_or_new_results_whole() {
    // Before the new ones are in place: the old ones are put back.
    let place = Place::new();
    place.results("old");
    fs::rename(place.at("out"), place.at("out.old")).unwrap();
    let refused = place.open().unwrap_err();
    assert!(matches!(refused, StoreError::NotEmpty { .. }), "{refused}");
    drop(place.open_as("b", false, true).unwrap());
    assert_eq!(place.read("out/summary.json"), "old");

    // Afterwards: what is left of the old ones goes.
    let place = Place::new();
    place.results("old");
    fs::rename(place.at("out"), place.at("out.old")).unwrap();
    fs::remove_file(place.at("out.old/summary.json")).unwrap();
    let store = place.open_as("a", false, true);
    // With the old ones in its place again, a part of them.
    drop(store.unwrap());
    place.results("new");
    assert_eq!(place.read("out/summary.json"), "new");
    assert_eq!(fs::read_dir(place.0.path()).unwrap().count(), 1);
}

#[test]
fn work_that_kept_nothing_leaves_nothing() {
    let place = Place::new();
    place.open().unwrap().discard_if_empty();
    assert_eq!(fs::read_dir(place.0.path()).unwrap().count(), 0);

    let store = place.open().unwrap();
    store.parts().save(0, &0).unwrap();
    store.discard_if_empty();
    assert_eq!(kept(&place.at("out")).unwrap(), 1);
}

#[test]
fn a_path_without_a_name_of_its_own_is_refused() {
    for out in ["..", "/", "."] {
        let request =
            Request { out: Path::new(out), kind: "run", fingerprint: "a", resume: false, force: true };
        assert!(matches!(Store::open(&request), Err(StoreError::NoName { .. })), "{out}");
    }
}

#[test]
fn places_that_no_folder_can_be_at_are_told_apart() {
    let place = Place::new();
    place.results("done");
    let finished = place.open_as("a", true, false).unwrap_err();
    assert!(matches!(finished, StoreError::Complete { .. }), "{finished}");
    let open = |out: &Path| {
        Store::open(&Request { out, kind: "run", fingerprint: "a", resume: false, force: true }).unwrap_err()
    };
    place.write("file", "");
    assert!(matches!(open(&place.at("file")), StoreError::NoFolder { .. }));
    let long = open(&place.at(&"n".repeat(300)));
    assert!(matches!(long, StoreError::LongName { .. }) && long.to_string().len() < 200, "{long}");
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(place.at("nowhere"), place.at("link")).unwrap();
        assert!(matches!(open(&place.at("link")), StoreError::DanglingLink { .. }));
    }
}
