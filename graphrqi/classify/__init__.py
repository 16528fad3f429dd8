"""Classifiers: feature vectors in, a probability for each class out; plain arrays throughout."""

from graphrqi.classify.contract import Classifier
from graphrqi.classify.registry import CLASSIFIERS, make_classifier, restore_classifier

__all__ = ["CLASSIFIERS", "Classifier", "make_classifier", "restore_classifier"]
