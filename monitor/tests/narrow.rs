//! Tests that important texts on a narrow screen are drawn completely or not at all.

use crate::common::Stage;
use crate::common::crowd::CROWD_NOW;
use imrs_monitor::theme::Theme;
use std::collections::BTreeSet;

/// On a narrow screen the header, the links and the heads of a rendezvous are whole words.
#[test]
fn what_has_no_room_is_left_out_and_not_cut_within_a_word() {
    let wide = Stage::crowd_at_work(Theme::ASCII).typed(CROWD_NOW, (200, 60), "");
    let words: Vec<&str> = wide.lines().next().unwrap().split_whitespace().collect();
    let links = |shown: &str| shown.lines().rfind(|line| line.starts_with(" links")).unwrap().to_owned();
    let (all, _) = links(&wide).split_once("  model").map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
    for width in 40..60 {
        let shown = Stage::crowd_at_work(Theme::ASCII).typed(CROWD_NOW, (width, 20), "");
        let head = shown.lines().next().unwrap();
        let last = head.split_whitespace().last().unwrap();
        assert!(last.ends_with(']') || words.contains(&last), "{width}: {head}");
    }
    for width in [64, 80, 100, 120] {
        let shown = links(&Stage::crowd_at_work(Theme::ASCII).typed(CROWD_NOW, (width, 20), ""));
        let shown = shown.split("  model").next().unwrap();
        let drawn = shown.rsplit_once(" +").map_or(shown, |(drawn, _)| drawn);
        assert!(all.starts_with(drawn), "{width}: {shown}: {all}");
        assert!(drawn == all || shown.contains(" +"), "{width}: {shown}");
    }
    for width in [64, 80, 120] {
        let shown = Stage::crowd_at_work(Theme::ASCII).typed(CROWD_NOW, (width, 20), "3");
        let head = shown.lines().find(|line| line.contains("MEMBER")).unwrap();
        let heads = head.split("ARRIVED").nth(1).unwrap().split("CONFI").next().unwrap();
        let names: BTreeSet<_> = heads.split_whitespace().collect();
        assert_eq!(names.len(), 4, "{width}: {head}");
    }
}

/// Beside a likely miss, how much time the message needs is read in full from eighty columns on.
#[test]
fn the_verdict_on_a_message_is_whole() {
    for width in [80, 99, 100, 119, 120, 160, 200] {
        let mut stage = Stage::crowd_at_work(Theme::ASCII);
        let shown = stage.typed(CROWD_NOW, (width, 24), ":port port45\n");
        let late = shown.lines().filter(|line| line.contains("MISS")).collect::<Vec<_>>();
        assert!(!late.is_empty(), "{width}: {shown}");
        for line in late {
            assert!(
                line.contains("MISS likely: needs ") && line.trim_end().ends_with("ms"),
                "{width}: {line}"
            );
        }
    }
}

/// While the user goes back, the bottom line says in whole words how to return.
#[test]
fn the_way_back_to_the_pause_is_whole() {
    for width in [80, 99, 100, 109, 110, 120, 200] {
        let shown = Stage::crowd_at_work(Theme::ASCII).typed(CROWD_NOW, (width, 24), " [[");
        let foot = shown.lines().last().unwrap();
        assert!(foot.contains("End returns") && foot.contains("space goes on "), "{width}: {foot}");
    }
}
