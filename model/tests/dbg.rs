mod support;
use imrs_model::Reductions;
use stateright::Model;
use support::reference::ReferenceModel;
use support::worlds::*;
#[test]
fn dbg() {
    let s = with(Reductions::NONE, &endless(2, 0));
    let m = ReferenceModel::new(&s, u64::MAX);
    let mut st = m.init_states().remove(0);
    for _ in 0..4000 {
        let mut a = vec![];
        m.actions(&st, &mut a);
        let act = a[0];
        st = m.next_state(&st, act).unwrap();
    }
    println!("{st:?}");
}
