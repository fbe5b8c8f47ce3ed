//! Sensor models p(z | beam) learnt from data
