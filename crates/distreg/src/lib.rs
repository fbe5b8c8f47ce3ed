//! Distribution regression: learn the whole distribution p(z | x) from samples
